"""The log that a run is on: its data, its content hash, and the world it was made from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from recast.core import folder_hash
from recast.core.remote import remote_path
from recast.errors import InputError
from recast.logs import DrivingLog, HdMap, map_of, read_log
from recast.logs.remote import local_folder
from recast.synthetic import World, world_of
from recast.synthetic.rendering import require_embree


@dataclass(frozen=True)
class SourceLog:
    """A log folder, opened.

    Attributes:
        path: the folder.
        log: its contents.
        hash: of all its bytes.
        address: where it lies, if that is another place than the folder, which holds a copy.
    """

    path: Path
    log: DrivingLog
    hash: str
    address: str | None = None

    @classmethod
    def open(cls, place: str | Path) -> SourceLog:
        """Read a log folder, here or in object storage.

        Raises:
            InputError: see `load_log`.
        """
        path = local_folder(place)
        remote = remote_path(place) is not None
        return cls(path, read_log(path), folder_hash(path), str(place) if remote else None)

    @cached_property
    def map(self) -> HdMap:
        """The log's map, or one derived from the drive."""
        return map_of(self.log)

    @cached_property
    def world(self) -> World:
        """What a synthetic log was made from.

        Raises:
            InputError: it is a recorded log, or no ray tracer is installed.
        """
        require_embree()
        return world_of(self.log)

    def require(self, track: str) -> None:
        """Refuse a track that the log lacks.

        Raises:
            InputError: lists those that it has.
        """
        if track not in self.log.tracks:
            raise InputError(
                self.path, f"track {track}", "is not in the log",
                f"choose one of {', '.join(self.log.tracks)}",
            )  # fmt: skip
