"""A vehicle set that lies in shards, used as one that lies in folders."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.geometry import PinholeCamera
from recast.recar.camera import view_camera
from recast.recar.picture import Image, check_encoded_header, decode_picture
from recast.recar.record import IdentityRecord, SetRecord, Split
from recast.recar.shards.layout import IndexRecord, Member, ShardRecord
from recast.recar.shards.members import parse_identity, read_member, shard_members


@dataclass(frozen=True)
class ShardedIdentity:
    """One vehicle in a shard; nothing of it is read before it is asked for.

    Attributes:
        id: its name.
        folder: of the shards.
        shard: that holds it.
        set_record: what it shares with all of the set.
    """

    id: str
    folder: Path
    shard: ShardRecord
    set_record: SetRecord

    @cached_property
    def record(self) -> IdentityRecord:
        """What is known about it.

        Raises:
            InputError: see `read_member` and `parse_identity`.
        """
        member = self.members[0]
        return parse_identity(self.path, self.shard, member, read_member(self.path, member))

    @property
    def path(self) -> Path:
        """The tar that holds it."""
        return self.folder / self.shard.file

    @property
    def members(self) -> tuple[Member, ...]:
        """Its files in the shard: the record, then the views."""
        return shard_members(self.folder, self.shard, self.set_record)[self.id]

    def view(self, index: int) -> Image:
        """(height, width, 4) uint8 RGBA with straight alpha.

        Raises:
            InputError: as `encoded`, or the picture is broken.
        """
        where = f"{self.path}: {self._member(index).name}"
        record = self.set_record
        return decode_picture(self.encoded(index), where, record.width, record.height)

    def encoded(self, index: int) -> bytes:
        """The PNG of a view.

        Raises:
            InputError: the shard is missing, cut short or damaged, in one line that names the shard
                and its member.
        """
        return read_member(self.path, self._member(index))

    def picture_bytes(self) -> int:
        """Bytes of all its pictures."""
        return sum(member.size for member in self.members[1:])

    def camera(self, index: int) -> tuple[PinholeCamera, NDArray[np.float64]]:
        """The camera of a view and `actor_from_camera` (4, 4); see `view_camera`."""
        return view_camera(self.set_record, self.record, index)

    def _member(self, index: int) -> Member:
        if not 0 <= index < self.set_record.views:
            raise IndexError(f"view {index}: {self.id} has 0 to {self.set_record.views - 1}")
        return self.members[1 + index]


@dataclass(frozen=True)
class ShardedSet:
    """A set in shards that was opened.

    Attributes:
        folder: of the shards.
        index: index.json.
        identities: by id, sorted.
    """

    folder: Path
    index: IndexRecord
    identities: dict[str, ShardedIdentity]

    @property
    def record(self) -> SetRecord:
        """set.json of the set that was packed."""
        return self.index.set

    def of_split(self, split: Split) -> Iterator[ShardedIdentity]:
        """The identities of one split, sorted; no shard is read."""
        return (one for one in self.identities.values() if one.shard.split == split)

    def records(self) -> Iterator[tuple[IdentityRecord, int]]:
        """Record and bytes of the pictures of every identity, one shard after the other.

        Raises:
            InputError: see `read_member` and `parse_identity`.
        """
        for shard in self.index.shards:
            path = self.folder / shard.file
            members = shard_members(self.folder, shard, self.record, keep=False)
            for name in shard.identities:
                if name in self.identities:  # not one that was left out when the set was opened
                    first, *views = members[name]
                    record = parse_identity(path, shard, first, read_member(path, first))
                    yield record, sum(view.size for view in views)

    def check_pictures(
        self, decode: bool = False, progress: Callable[[int, int], None] | None = None
    ) -> None:
        """Read everything in the order in which it lies, and look at its hashes.

        Args:
            decode: also decode every picture; slow.
            progress: called with pictures done and all pictures.

        Raises:
            InputError: the first member that is wrong.
        """
        from recast.recar.shards.stream import stream_identities

        views, done = self.record.views, 0
        for identity in stream_identities(self):
            for index in range(views):
                if decode:
                    identity.view(index)
                else:
                    check_encoded_header(
                        identity.encoded(index), identity.where(index),
                        self.record.width, self.record.height,
                    )  # fmt: skip
                done += 1
                if progress is not None:
                    progress(done, views * len(self.identities))
