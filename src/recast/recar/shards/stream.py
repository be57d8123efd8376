"""Reading shards in one pass, an identity at a time, mixed by a shuffle buffer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import PinholeCamera
from recast.recar.camera import view_camera
from recast.recar.picture import Image, decode_picture
from recast.recar.record import IdentityRecord, SetRecord, Split
from recast.recar.shards.layout import Member
from recast.recar.shards.members import parse_identity, read_members
from recast.recar.shards.sharded_set import ShardedIdentity, ShardedSet

BUFFER = 16


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
