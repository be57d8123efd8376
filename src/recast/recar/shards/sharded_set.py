"""A vehicle set that lies in shards: used as one in folders, or read in one pass, shuffled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.core.errors import InputError
from recast.core.progress import Progress
from recast.geometry import PinholeCamera
from recast.recar.record import IdentityRecord, SetRecord, Split
from recast.recar.shards.layout import (
    IndexRecord,
    Member,
    ShardRecord,
    parse_identity,
    read_member,
    read_members,
    shard_members,
)
from recast.recar.views import Image, check_encoded_header, decode_picture, view_camera

BUFFER = 16


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

    def check_pictures(self, decode: bool = False, progress: Progress | None = None) -> None:
        """Read everything in the order in which it lies, and look at its hashes.

        Args:
            decode: also decode every picture; slow.
            progress: called with pictures done and all pictures.

        Raises:
            InputError: the first member that is wrong.
        """

        views, done = self.record.views, 0
        for identity in stream_identities(self):
            for index in range(views):
                if decode:
                    identity.view(index)
                else:
                    check_encoded_header(
                        identity.encoded(index),
                        identity.where(index),
                        self.record.width,
                        self.record.height,
                    )
                done += 1
                if progress is not None:
                    progress(done, views * len(self.identities))


@dataclass(frozen=True)
class LoadedIdentity:
    """One vehicle with the bytes of all its files in memory; its pictures are not yet decoded.

    Attributes:
        record: what is known about it.
        set_record: what it shares with all of the set.
        path: the tar that it was read from.
        members: its files in the shard: the record, then the views.
        pictures: PNG of each view.
    """

    record: IdentityRecord
    set_record: SetRecord
    path: Path
    members: tuple[Member, ...]
    pictures: tuple[bytes, ...]

    def view(self, index: int) -> Image:
        """(height, width, 4) uint8 RGBA with straight alpha.

        Raises:
            InputError: the picture is broken.
        """
        record = self.set_record
        return decode_picture(self.encoded(index), self.where(index), record.width, record.height)

    def encoded(self, index: int) -> bytes:
        """The PNG of a view."""
        if not 0 <= index < len(self.pictures):
            raise IndexError(f"view {index}: {self.record.id} has 0 to {len(self.pictures) - 1}")
        return self.pictures[index]

    def picture_bytes(self) -> int:
        """Bytes of all its pictures."""
        return sum(len(picture) for picture in self.pictures)

    def camera(self, index: int) -> tuple[PinholeCamera, NDArray[np.float64]]:
        """The camera of a view and `actor_from_camera` (4, 4); see `view_camera`."""
        return view_camera(self.set_record, self.record, index)

    def where(self, index: int) -> str:
        """Shard and member of a view, for messages."""
        return f"{self.path}: {self.members[1 + index].name}"


def stream_identities(
    sharded_set: ShardedSet,
    split: Split | None = None,
    *,
    rng: np.random.Generator | None = None,
    buffer: int = BUFFER,
    part: tuple[int, int] = (0, 1),
    on_bad: Callable[[InputError], None] | None = None,
) -> Iterator[LoadedIdentity]:
    """All identities once, read with one request each in the order in which they lie.

    Args:
        sharded_set: opened.
        split: only this one; both where it is None.
        rng: shuffles the shards, then identities among the `buffer` that are in memory; None keeps
            the order of the shards.
        buffer: identities in memory; one of the paper's set is some 15 MB.
        part: (rank, ranks): of several readers whose `rng` are equal, each takes its own
            identities and reads no others; their numbers differ by at most one.
        on_bad: called for each identity that cannot be read, which is then skipped; None raises.

    Raises:
        InputError: the first identity whose shard is missing, cut short or damaged.
    """
    rank, ranks = part
    if buffer < 1 or not 0 <= rank < ranks:
        raise ValueError(f"stream_identities: buffer {buffer}, part {part}")
    order = _in_order(sharded_set, split, rng)[rank::ranks]
    loaded = _load(order, on_bad)
    return loaded if rng is None else _shuffled(loaded, buffer, rng.spawn(ranks)[rank])


def _in_order(
    sharded_set: ShardedSet, split: Split | None, rng: np.random.Generator | None
) -> list[ShardedIdentity]:
    shards = [shard for shard in sharded_set.index.shards if split in (None, shard.split)]
    if rng is not None:
        shards = [shards[i] for i in rng.permutation(len(shards))]
    identities = sharded_set.identities  # without those that were left out when it was opened
    return [identities[name] for one in shards for name in one.identities if name in identities]


def _load(
    order: list[ShardedIdentity], on_bad: Callable[[InputError], None] | None
) -> Iterator[LoadedIdentity]:
    for identity in order:
        try:
            members = identity.members
            first, *pictures = read_members(identity.path, members)
            record = parse_identity(identity.path, identity.shard, members[0], first)
        except InputError as error:
            if on_bad is None:
                raise
            on_bad(error)
            continue
        yield LoadedIdentity(record, identity.set_record, identity.path, members, tuple(pictures))


def _shuffled(
    loaded: Iterator[LoadedIdentity], buffer: int, rng: np.random.Generator
) -> Iterator[LoadedIdentity]:
    held: list[LoadedIdentity] = []
    for identity in loaded:
        held.append(identity)
        if len(held) == buffer:
            yield held.pop(int(rng.integers(len(held))))
    while held:
        yield held.pop(int(rng.integers(len(held))))
