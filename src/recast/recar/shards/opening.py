"""Opening a folder of shards, or a set of either kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from recast.core.errors import InputError
from recast.core.records import read_record
from recast.recar.record import SetRecord
from recast.recar.shards.layout import (
    INDEX_FILE,
    MEND,
    SHARDS_FORMAT,
    SHARDS_VERSION,
    IndexRecord,
    ShardRecord,
    cut_short,
    shard_members,
)
from recast.recar.shards.sharded_set import ShardedIdentity, ShardedSet
from recast.recar.vehicle_set import VehicleSet, read_set

OnBad = Callable[[InputError], None]


def open_set(folder: str | Path) -> VehicleSet | ShardedSet:
    """A set in folders or in shards, by what lies there.

    Raises:
        InputError: see `read_set` and `read_shards`.
    """
    return read_shards(folder) if (Path(folder) / INDEX_FILE).is_file() else read_set(folder)


def read_shards(folder: str | Path, on_bad: OnBad | None = None) -> ShardedSet:
    """Open a folder of shards: index.json is read, and the size of each shard looked at.

    Args:
        folder: of the shards.
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
            "is false: the shards are still in the making",
            "run `recast recar pack` again; it resumes",
        )
    _check_identities(folder, index)
    identities: dict[str, ShardedIdentity] = {}
    for shard in index.shards:
        for name in _readable(folder, shard, index.set, on_bad):
            identities[name] = ShardedIdentity(name, folder, shard, index.set)
    return ShardedSet(folder, index, dict(sorted(identities.items())))


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
            f"{len(place)} in the shards, {index.identities} counted, {index.set.identities} in "
            "the set",
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
