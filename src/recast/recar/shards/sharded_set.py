"""A vehicle set in shards: opened, used as one in folders, or read in one pass, shuffled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from recast.core.errors import InputError
from recast.core.records import read_record
from recast.recar.set_records import IdentityRecord, SetRecord, Split
from recast.recar.shards.layout import (
    INDEX_FILE,
    MEND,
    SHARDS_FORMAT,
    SHARDS_VERSION,
    IndexRecord,
    Member,
    ShardRecord,
    cut_short,
    parse_identity,
    read_member,
    read_members,
    shard_members,
)
from recast.recar.vehicle_set import VehicleSet, read_set
from recast.recar.views import IdentitySource, VehicleSource

BUFFER = 16
OnBad = Callable[[InputError], None]


@dataclass(frozen=True)
class ShardedIdentity(IdentitySource):
    """One vehicle in a shard, by its id; nothing of it is read before it is asked for."""

    id: str
    folder: Path
    shard: ShardRecord
    set_record: SetRecord

    @cached_property
    def record(self) -> IdentityRecord:  # type: ignore[override]
        """What is known about it; see `read_member` and `parse_identity` for errors."""
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

    def where(self, index: int) -> str:
        """Shard and member of a view."""
        return f"{self.path}: {self._member(index).name}"

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

    def _member(self, index: int) -> Member:
        if not 0 <= index < self.set_record.views:
            raise IndexError(f"view {index}: {self.id} has views 0 to {self.set_record.views - 1}")
        return self.members[1 + index]


@dataclass(frozen=True)
class ShardedSet(VehicleSource):
    """A set in shards that was opened; `record` is that of the set that was packed."""

    folder: Path
    index: IndexRecord
    record: SetRecord
    identities: dict[str, ShardedIdentity]

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

    def in_order(self) -> Iterator[LoadedIdentity]:
        """All identities, one shard after the other, their hashes looked at."""
        return stream_identities(self)


@dataclass(frozen=True)
class LoadedIdentity(IdentitySource):
    """One vehicle with the bytes of all its files in memory; its pictures are not yet decoded.

    Attributes:
        path: the tar that it was read from.
        members: its files in the shard: the record, then the views.
        pictures: PNG of each view.
    """

    record: IdentityRecord
    set_record: SetRecord
    path: Path
    members: tuple[Member, ...]
    pictures: tuple[bytes, ...]

    def encoded(self, index: int) -> bytes:
        """The PNG of a view."""
        if not 0 <= index < len(self.pictures):
            raise IndexError(
                f"view {index}: {self.record.id} has views 0 to {len(self.pictures) - 1}"
            )
        return self.pictures[index]

    def picture_bytes(self) -> int:
        """Bytes of all its pictures."""
        return sum(len(picture) for picture in self.pictures)

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
        sharded_set: set that was opened.
        split: split to read; both where it is None.
        rng: generator that shuffles the shards, then identities among the `buffer` that are in
            memory; None keeps the order of the shards.
        buffer: number of identities in memory; one of the paper's set is some 15 MB.
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


def open_set(folder: str | Path) -> VehicleSet | ShardedSet:
    """A set in folders or in shards, by what lies there.

    Raises:
        InputError: see `read_set` and `read_shards`.
    """
    return read_shards(folder) if (Path(folder) / INDEX_FILE).is_file() else read_set(folder)


def read_shards(folder: str | Path, on_bad: OnBad | None = None) -> ShardedSet:
    """Open a folder of shards: index.json is read, and the size of each shard looked at.

    Args:
        folder: folder of the shards.
        on_bad: called for each shard that is missing or of a wrong size, whose identities are then
            left out as far as they cannot be read; None raises.

    Raises:
        InputError: no shards or shards in the making, a shard missing, cut short or too long, an
            identity twice or in both splits, or counts that do not agree.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(folder, "shards", "are missing", "check the path")
    index = read_record(folder / INDEX_FILE, IndexRecord, SHARDS_VERSION, MEND, SHARDS_FORMAT)
    if not index.complete:
        raise InputError(
            folder / INDEX_FILE,
            "complete",
            "is false: the shards are not complete",
            "run `recast recar pack` again; it resumes",
        )
    _check_identities(folder, index)
    identities: dict[str, ShardedIdentity] = {}
    for shard in index.shards:
        for name in _readable(folder, shard, index.set, on_bad):
            identities[name] = ShardedIdentity(name, folder, shard, index.set)
    return ShardedSet(folder, index, index.set, dict(sorted(identities.items())))


def _check_identities(folder: Path, index: IndexRecord) -> None:
    place: dict[str, ShardRecord] = {}
    for shard in index.shards:
        for name in shard.identities:
            if name in place:
                first = place[name]
                how = "in both splits" if first.split != shard.split else "packed twice"
                raise InputError(
                    folder / INDEX_FILE,
                    name,
                    f"is {how}: in {first.file} ({first.split}) and {shard.file} ({shard.split})",
                    "pack the set again",
                )
            place[name] = shard
    if len(place) != index.identities or index.identities != index.set.identities:
        raise InputError(
            folder / INDEX_FILE,
            "identities",
            f"{len(place)} in the shards, {index.identities} in index.json, "
            f"{index.set.identities} in the set",
            "pack the set again",
        )


def _readable(
    folder: Path, shard: ShardRecord, record: SetRecord, on_bad: OnBad | None
) -> tuple[str, ...]:
    path = folder / shard.file
    try:
        size = path.stat().st_size
    except OSError:
        error = InputError(path, "shard", f"is missing: {_named(shard.identities)}", MEND)
        return _left_out(error, on_bad)
    if size == shard.bytes:
        return shard.identities
    if size > shard.bytes:
        error = InputError(path, "shard", f"has {size} bytes, not {shard.bytes}", MEND)
        return _left_out(error, on_bad)
    try:
        members = shard_members(folder, shard, record)
    except InputError as unlisted:
        return _left_out(unlisted, on_bad)
    for place, name in enumerate(shard.identities):
        for member in members[name]:
            if member.offset + member.size > size:
                _left_out(cut_short(path, member), on_bad)
                return shard.identities[:place]
    # Only the blocks of zeros that close the archive are gone.
    error = InputError(path, "shard", f"ends after {size} bytes of {shard.bytes}", MEND)
    _left_out(error, on_bad)
    return shard.identities


def _left_out(error: InputError, on_bad: OnBad | None) -> tuple[str, ...]:
    if on_bad is None:
        raise error
    on_bad(error)
    return ()


def _named(identities: tuple[str, ...]) -> str:
    more = f" and {len(identities) - 1} more" if len(identities) > 1 else ""
    return f"it holds {identities[0]}{more}"
