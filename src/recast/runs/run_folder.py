"""A run folder: what was asked for, references to the artefacts that came of it, and the report.

docs/runs.md lists its files. Names inside of artefacts stand here, too."""

from __future__ import annotations

import json
import logging
import os
import platform
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from recast import __version__
from recast.core import Artefact, Store, files, open_store
from recast.core.artefact import remote_path
from recast.core.errors import InputError
from recast.core.files import folder_name
from recast.core.records import Record, parse_record, read_record
from recast.logs.load import local_folder
from recast.runs.config import CONFIG_VERSION, RunConfig, as_written_now

STORE_FOLDER = "store"
"""Name of the store beside the run folders, where no other is named."""
LOG_FOLDER = "log"
OBSERVATION_FOLDER = "observation"
EVIDENCE_FILE = "observation/evidence.safetensors"
ACTOR_FOLDER = "actor"
REFINEMENT_CHECKPOINT = "refinement.safetensors"
TURNTABLE_FILE = "turntable.mp4"
VIEWS_FOLDER = "views"
METRICS_FILE = "metrics.json"
REPORT_FOLDER = "report"
REPLAY_FILE = "replay.html"


def use_name(what: str, *names: str) -> str:
    """What a run calls an artefact, such as "scene/recast".

    Args:
        names: names from outside, of tracks, planners, arms and streets; a "/" in one is escaped,
            so that other names never give the same use.
    """
    return "/".join([what, *(name.replace("%", "%25").replace("/", "%2F") for name in names)])


def rollout_name(motion: str, planner: str, arm: str) -> str:
    """What a run calls a rollout."""
    return use_name("rollout", motion, planner, arm)


def use_parts(use: str) -> tuple[str, ...]:
    """What `use_name` was given."""
    return tuple(part.replace("%2F", "/").replace("%25", "%") for part in use.split("/"))


_LOG = logging.getLogger(__name__)

RUN_FILE = "run.json"
RUN_FORMAT: Literal["recast-run"] = "recast-run"
RUN_VERSION: Literal[3] = 3
_LINKS = {
    "log": "log",
    "scene": "scenes",
    "actor": "actors",
    "registered": "registered",
    "turntable": "turntables",
    "evaluation": "evaluations",
    "truth": "truth",
    "rollout": "rollouts",
    "plans": "plans",
}
"""Folder of the links to artefacts, by the first word of their use."""


class LogSource(Record):
    """The log of a run: its address or path, relative to the run if it can be, and its hash."""

    path: str
    hash: str


class RunRecord(Record):
    """run.json.

    Attributes:
        store: address of the store, or its folder, relative to the run if it can be.
        artefacts: reference by use, such as "scene/recast".
        finished: hash of what a file was made from, by name of the file; for files that the run
            wrote itself.
    """

    format: Literal["recast-run"] = RUN_FORMAT
    version: Literal[3] = RUN_VERSION
    config: dict[str, Any]
    log: LogSource
    store: str
    versions: dict[str, str]
    artefacts: dict[str, str] = Field(default_factory=dict)
    finished: dict[str, str] = Field(default_factory=dict)

    @field_validator("config")
    @classmethod
    def _as_written_now(cls, value: dict[str, Any]) -> dict[str, Any]:
        return as_written_now(value)


@dataclass
class RunFolder:
    """An opened run folder; `record` is the contents of `run.json`."""

    path: Path
    record: RunRecord

    @classmethod
    def create_or_resume(
        cls, path: str | Path, config: dict[str, Any], log: str | Path, log_hash: str, store: str
    ) -> RunFolder:
        """Start a run, or resume the one that lies there.

        Args:
            path: run folder, made where it is missing.
            config: resolved settings, JSON-able.
            log, store: folder or address of each.
            log_hash: content hash of the log.

        Raises:
            InputError: the folder holds something else: another log, another configuration,
                another version, or files that are no run.
        """
        path = Path(path)
        source = LogSource(path=_place(log, path), hash=log_hash)
        place = _place(store, path)
        if not (path / RUN_FILE).exists():
            claim_empty(path, RUN_FILE)
            record = RunRecord(config=config, log=source, store=place, versions=_versions())
            folder = cls(path, record)
            folder._write()
            return folder
        existing = cls.open(path).record
        mend = "name another `out`, or give the options of the run in this folder"
        if existing.log.hash != log_hash:
            raise InputError(
                path / RUN_FILE,
                "log.hash",
                f"this folder holds a run on another log ({existing.log.path})",
                mend,
            )
        differing = first_difference(existing.config, config)
        if differing is not None:
            raise InputError(
                path / RUN_FILE,
                f"config.{differing}",
                "this folder holds a run with another configuration",
                mend,
            )
        folder = cls(path, existing.model_copy(update={"log": source, "store": place}))
        if folder.record != existing:  # the run, the log or the store was moved
            folder._write()
        return folder

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """Open an existing run.

        Raises:
            InputError: not a run folder, or of another version.
        """
        path = Path(path)
        mend = "name a folder that this version of `recast run` made"
        return cls(path, read_record(path / RUN_FILE, RunRecord, RUN_VERSION, mend, RUN_FORMAT))

    @property
    def config(self) -> RunConfig:
        """The configuration of the run.

        Raises:
            InputError: its record was damaged.
        """
        return parse_record(
            self.path / RUN_FILE,
            self.record.config,
            RunConfig,
            CONFIG_VERSION,
            "run again into a new folder",
        )

    @property
    def log_path(self) -> Path:
        """The log's folder; of one elsewhere that of its copy. InputError: see `local_folder`."""
        place = self.record.log.path
        if remote_path(place) is not None:
            return local_folder(place)
        return Path(os.path.normpath(self.path / place))

    def store(self) -> Store:
        """The store that the run refers to; InputError: see `open_store`."""
        place = self.record.store
        return open_store(
            place if remote_path(place) is not None else os.path.normpath(self.path / place)
        )

    def refer(self, store: Store, used: Mapping[str, Artefact], whole: bool = False) -> None:
        """Note the artefacts of the run, in its record, in the store, and as links.

        Args:
            whole: whether these are all; else those that an earlier try used stay noted, so that a
                run that is stopped while it goes on loses nothing.
        """
        names = {use: artefact.reference for use, artefact in used.items()}
        names = dict(sorted((names if whole else {**self.record.artefacts, **names}).items()))
        try:
            store.refer(self.path, tuple(dict.fromkeys(names.values())))
        except InputError as error:  # all that the run needs may lie in a store to read only
            _LOG.warning("the store could not record this run: %s", error)
        for use, artefact in used.items():
            self._link(use, artefact)
        if names != self.record.artefacts:
            self.record = self.record.model_copy(update={"artefacts": names})
            self._write()

    def artefact(self, store: Store, use: str) -> Artefact | None:
        """The artefact of a use; None where the run has not made it yet.

        Raises:
            InputError: it is no longer in the store, or damaged.
        """
        reference = self.record.artefacts.get(use)
        return None if reference is None else store.open(reference)

    def finish(self, name: str, made_from: str, make: Callable[[], object]) -> None:
        """Write one of the run's own files or folders, unless it was made from the same before.

        Args:
            made_from: hash of everything that it depends on.
            make: writes it, whole or not at all.
        """
        if self.record.finished.get(name) == made_from and (self.path / name).exists():
            return
        make()
        finished = {**self.record.finished, name: made_from}
        self.record = self.record.model_copy(update={"finished": finished})
        self._write()

    def _write(self) -> None:
        files.write_json(self.path / RUN_FILE, self.record.model_dump(mode="json"))

    def _link(self, use: str, artefact: Artefact) -> None:
        what, *names = use_parts(use)
        parts = [folder_name(name) for name in names]
        # Only rollouts are nested: the link of an arm's target is no folder for its other vehicles.
        parts = parts if what == "rollout" else ["~~".join(parts)]
        link = self.path.joinpath(_LINKS[what], *parts)
        target = _relative(artefact.path, link.parent)
        with files.disk_errors(link):
            if link.is_symlink() and link.readlink().as_posix() == target:
                return
            if link.exists() and not link.is_symlink():
                if _is_copy(link, artefact):  # the run was copied without its links
                    return
                raise InputError(
                    link,
                    "link",
                    "is a file or folder that does not belong to this run",
                    "move it elsewhere",
                )
            link.parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileNotFoundError):
                link.unlink()
        with suppress(OSError, NotImplementedError):  # a file system without links
            link.symlink_to(target, target_is_directory=True)


def claim_empty(folder: Path, first: str) -> None:
    """Make a folder, or take an empty one.

    Args:
        first: the file that will be written first; what a kill left of it does not count.

    Raises:
        InputError: something else lies there.
    """
    with files.disk_errors(folder):
        inside = {entry.name for entry in folder.iterdir()} if folder.is_dir() else set()
        if (folder.exists() and not folder.is_dir()) or inside - {files.partial_name(first).name}:
            raise InputError(
                folder,
                first,
                "is missing in a folder that is not empty",
                "name a new or empty folder for `out`",
            )
        folder.mkdir(parents=True, exist_ok=True)


def _place(place: str | Path, folder: Path) -> str:
    """An address as it is, a path as seen from a folder."""
    return str(place) if remote_path(place) is not None else _relative(Path(place), folder)


def _is_copy(folder: Path, artefact: Artefact) -> bool:
    """Whether a folder has the files of an artefact, by their names and sizes."""
    there = {
        path.relative_to(folder).as_posix(): path.stat().st_size
        for path in folder.rglob("*")
        if path.is_file()
    }
    return there == {name: file.size for name, file in artefact.record.files.items()}


def _relative(path: Path, folder: Path) -> str:
    """A path as seen from a folder: both may be moved together."""
    try:
        return Path(os.path.relpath(path.absolute(), folder.absolute())).as_posix()
    except ValueError:  # on another drive, on Windows
        return str(path.absolute())


def _versions() -> dict[str, str]:
    return {
        "recast": __version__,
        "python": platform.python_version(),
        "torch": version("torch"),
        "numpy": version("numpy"),
        "machine": platform.machine(),
    }


def first_difference(first: Any, second: Any, where: str = "") -> str | None:
    """Dotted name of the first member in which two JSON-able values differ, or None."""
    if isinstance(first, dict) and isinstance(second, dict):
        for key in sorted(first.keys() | second.keys()):
            inner = f"{where}.{key}" if where else key
            if key not in first or key not in second:
                return inner
            found = first_difference(first[key], second[key], inner)
            if found is not None:
                return found
        return None
    return None if json.dumps(first) == json.dumps(second) else where
