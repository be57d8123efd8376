"""A run folder: its resolved configuration, and which steps are finished.

`run.json` says what the run is: the configuration, the content hash of the log, versions. A
finished step leaves `steps/NAME.json` with the hash of everything it was made from; a rerun skips
it while that hash stays the same, and makes it and all later steps anew where it changed.
"""

from __future__ import annotations

import fcntl
import json
import os
import platform
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from recast import __version__, storage
from recast.errors import InputError
from recast.pipeline.fingerprint import value_hash

RUN_SCHEMA = 1


@dataclass(frozen=True)
class RunFolder:
    """An opened run folder.

    Attributes:
        path: the folder.
        record: the contents of `run.json`.
    """

    path: Path
    record: dict[str, Any]

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
                another schema version, or files that are no run.
        """
        path = Path(path)
        record = {
            "schema": RUN_SCHEMA,
            "config": config,
            "log": {"path": log_path, "hash": log_hash},
            "versions": _versions(),
        }
        if not (path / "run.json").exists():
            if path.exists() and (not path.is_dir() or any(path.iterdir())):
                raise InputError(
                    path, "run.json", "is missing in a folder that is not empty",
                    "name a new or empty folder for --out",
                )  # fmt: skip
            path.mkdir(parents=True, exist_ok=True)
            storage.write_json(path / "run.json", record)
            return cls(path, record)
        existing = cls.open(path).record
        mend = "name another --out, or repeat the options of the run that lies there"
        if existing["log"]["hash"] != log_hash:
            raise InputError(
                path / "run.json", "log.hash",
                f"this folder holds a run on another log ({existing['log']['path']})", mend,
            )  # fmt: skip
        differing = _first_difference(existing["config"], config)
        if differing is not None:
            raise InputError(
                path / "run.json", f"config.{differing}",
                "this folder holds a run with another configuration", mend,
            )  # fmt: skip
        return cls(path, existing)

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """Open an existing run.

        Raises:
            InputError: not a run folder, or of another schema version.
        """
        path = Path(path)
        record = storage.read_json(path / "run.json")
        if not isinstance(record, dict) or not {"schema", "config", "log"} <= record.keys():
            raise InputError(
                path / "run.json", "schema", "this is no run record",
                "name a folder that `recast run` made",
            )  # fmt: skip
        if record["schema"] != RUN_SCHEMA:
            raise InputError(
                path / "run.json", "schema",
                f"version {record['schema']} where this recast reads {RUN_SCHEMA}",
                "run again into a new folder",
            )  # fmt: skip
        return cls(path, record)

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
        """
        fingerprint = value_hash({"step": name, "inputs": inputs})
        marker = self.path / "steps" / f"{name}.json"
        finished = None
        if marker.exists():
            finished = storage.read_json(marker).get("fingerprint")
            if finished == fingerprint and all((self.path / o).exists() for o in outputs):
                return fingerprint, False
            marker.unlink()
        if not keep_partial or (finished is not None and finished != fingerprint):
            for output in outputs:
                _remove(self.path / output)
        start = time.monotonic()
        make()
        self._note_time(name, time.monotonic() - start)
        storage.write_json(marker, {"fingerprint": fingerprint, "inputs": inputs})
        return fingerprint, True

    def _note_time(self, name: str, seconds: float) -> None:
        # Kept apart from every result: two runs with the same seed must give the same bytes there.
        path = self.path / "timings.json"
        with _alone_in(self.path):
            timings = storage.read_json(path) if path.exists() else {}
            timings[name] = round(seconds, 2)
            storage.write_json(path, timings)


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Other processes that ask for the same folder wait: rollouts of a run may be made at once."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)  # unlocks


def _remove(path: Path) -> None:
    if path.is_dir():
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
