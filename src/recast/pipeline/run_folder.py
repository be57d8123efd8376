"""A run folder: its resolved configuration, and which steps are finished.

`run.json` says what the run is: the configuration, the content hash of the log, versions. A
finished step leaves `steps/NAME.json` with the hash of everything it was made from; a rerun skips
it while that hash stays the same, and makes it and all later steps anew where it changed.
"""

from __future__ import annotations

import json
import logging
import platform
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, NonNegativeFloat

from recast import __version__, storage
from recast.errors import InputError
from recast.names import member
from recast.pipeline.fingerprint import value_hash
from recast.records import Record, read_record

RUN_FILE, TIMINGS_FILE = "run.json", "timings.json"
RUN_FORMAT: Literal["recast-run"] = "recast-run"
RUN_VERSION: Literal[2] = 2
STEP_VERSION: Literal[1] = 1

_LOG = logging.getLogger(__name__)


class LogSource(Record):
    """The log of a run: where it was read from, for people, and its content hash."""

    path: str
    hash: str


class RunRecord(Record):
    """run.json."""

    format: Literal["recast-run"] = RUN_FORMAT
    version: Literal[2] = RUN_VERSION
    config: dict[str, Any]
    log: LogSource
    versions: dict[str, str]


class StepRecord(Record):
    """steps/NAME.json: the hash of a finished step's inputs, and the inputs."""

    version: Literal[1] = STEP_VERSION
    fingerprint: str
    inputs: dict[str, Any]


class TimingsRecord(Record):
    """timings.json: seconds by step."""

    version: Literal[1] = STEP_VERSION
    seconds: dict[str, NonNegativeFloat] = Field(default_factory=dict)


@dataclass(frozen=True)
class RunFolder:
    """An opened run folder.

    Attributes:
        path: the folder.
        record: the contents of `run.json`.
    """

    path: Path
    record: RunRecord

    @classmethod
    def create_or_resume(
        cls, path: str | Path, config: dict[str, Any], log_path: str, log_hash: str
    ) -> RunFolder:
        """Start a run, or resume the one that lies there.

        Args:
            path: the run folder; made where it is missing.
            config: the resolved configuration, JSON-able.
            log_path: where the log was read from, for people.
            log_hash: content hash of the log.

        Raises:
            InputError: the folder holds something else: another log, another configuration,
                another version, or files that are no run.
        """
        path = Path(path)
        if not (path / RUN_FILE).exists():
            claim_empty(path, RUN_FILE)
            source = LogSource(path=log_path, hash=log_hash)
            record = RunRecord(config=config, log=source, versions=_versions())
            storage.write_json(path / RUN_FILE, record.model_dump(mode="json"))
            return cls(path, record)
        existing = cls.open(path).record
        mend = "name another --out, or repeat the options of the run that lies there"
        if existing.log.hash != log_hash:
            raise InputError(
                path / RUN_FILE, "log.hash",
                f"this folder holds a run on another log ({existing.log.path})", mend,
            )  # fmt: skip
        differing = _first_difference(existing.config, config)
        if differing is not None:
            raise InputError(
                path / RUN_FILE, f"config.{differing}",
                "this folder holds a run with another configuration", mend,
            )  # fmt: skip
        return cls(path, existing)

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """Open an existing run.

        Raises:
            InputError: not a run folder, or of another version.
        """
        path = Path(path)
        mend = "name a folder that this version of `recast run` made"
        return cls(path, read_record(path / RUN_FILE, RunRecord, RUN_VERSION, mend, RUN_FORMAT))

    def step(
        self,
        name: str,
        inputs: dict[str, Any],
        make: Callable[[], None],
        outputs: tuple[str, ...] = (),
        keep_partial: bool = False,
    ) -> tuple[str, bool]:
        """Make a step unless it is finished already with the same inputs.

        Args:
            name: the step's name.
            inputs: JSON-able; everything the result depends on (settings, hashes of earlier steps).
            make: does the work, writing below the run folder.
            outputs: files or folders, relative to the run, that the step makes. They are removed
                before it is made anew, and their absence means that it is not finished.
            keep_partial: leave unfinished outputs in place, for a step that resumes by itself.

        Returns:
            the hash of the step's inputs, to be named in the inputs of later steps, and whether the
            step was made now (False: it was found finished).

        Raises:
            InputError: an output lies outside of the run folder; or the step's record is damaged.
        """
        fingerprint = value_hash({"step": name, "inputs": inputs})
        marker = member(self.path, f"steps/{name}.json", self.path, f"step {name}")
        made = [member(self.path, output, self.path, f"step {name}") for output in outputs]
        finished = None
        if marker.exists():
            mend = f"remove {marker.name}, and the step is made again"
            finished = read_record(marker, StepRecord, STEP_VERSION, mend).fingerprint
            if finished == fingerprint and all(output.exists() for output in made):
                _LOG.debug("%s: finished before, %s", name, fingerprint)
                return fingerprint, False
        with storage.disk_errors(self.path):
            marker.unlink(missing_ok=True)
            if not keep_partial or (finished is not None and finished != fingerprint):
                for output in made:
                    _remove(output)
        _LOG.debug("%s: begins, was %s, becomes %s", name, finished, fingerprint)
        start = time.monotonic()
        make()
        seconds = time.monotonic() - start
        self._note_time(name, seconds)
        record = StepRecord(fingerprint=fingerprint, inputs=inputs)
        storage.write_json(marker, record.model_dump(mode="json"))
        _LOG.debug("%s: finished in %.1f s", name, seconds)
        return fingerprint, True

    def timings(self) -> dict[str, float]:
        """Seconds by step; {} where none was made.

        Raises:
            InputError: the file is damaged.
        """
        path = self.path / TIMINGS_FILE
        if not path.exists():
            return {}
        return read_record(path, TimingsRecord, STEP_VERSION, "remove it").seconds

    def _note_time(self, name: str, seconds: float) -> None:
        # Kept apart from every result: two runs with the same seed must give the same bytes there.
        # Rollouts of a run may be made by several workers at once, hence the lock; not on the run
        # folder itself, which the whole run holds.
        steps = self.path / "steps"
        with storage.disk_errors(steps):
            steps.mkdir(exist_ok=True)
        with storage.alone_in(steps, wait=True):
            record = TimingsRecord(seconds={**self.timings(), name: round(seconds, 2)})
            storage.write_json(self.path / TIMINGS_FILE, record.model_dump(mode="json"))


def claim_empty(folder: Path, first: str) -> None:
    """Make a folder, or take an empty one.

    Args:
        first: the file that will be written first; what a kill left of it does not count.

    Raises:
        InputError: something else lies there.
    """
    with storage.disk_errors(folder):
        inside = {entry.name for entry in folder.iterdir()} if folder.is_dir() else set()
        if (folder.exists() and not folder.is_dir()) or inside - {storage.partial_name(first).name}:
            raise InputError(
                folder, first, "is missing in a folder that is not empty",
                "name a new or empty folder for --out",
            )  # fmt: skip
        folder.mkdir(parents=True, exist_ok=True)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _versions() -> dict[str, str]:
    return {
        "recast": __version__,
        "python": platform.python_version(),
        "torch": version("torch"),
        "numpy": version("numpy"),
        "machine": platform.machine(),
    }


def _first_difference(first: Any, second: Any, where: str = "") -> str | None:
    """Dotted name of the first member in which two JSON-able values differ, or None."""
    if isinstance(first, dict) and isinstance(second, dict):
        for key in sorted(first.keys() | second.keys()):
            inner = f"{where}.{key}" if where else key
            if key not in first or key not in second:
                return inner
            found = _first_difference(first[key], second[key], inner)
            if found is not None:
                return found
        return None
    return None if json.dumps(first) == json.dumps(second) else where
