"""Reading the members of a shard: only those asked for, and never without a look at their hash."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

from recast.errors import InputError
from recast.recar.picture import MOST_BYTES
from recast.recar.record import SET_VERSION, IdentityRecord, SetRecord
from recast.recar.shards.layout import (
    MEND,
    SHARDS_VERSION,
    Member,
    MembersRecord,
    ShardRecord,
    member_names,
    members_file,
)
from recast.recar.shards.tar import END, member_header, padding
from recast.records import parse_record
from recast.storage import JSON_LIMIT, disk_errors, parse_json, read_bytes

_LISTS_KEPT = 128  # of members, of the paper's pictures about 1 MB each in memory


def shard_members(
    folder: Path, shard: ShardRecord, set_record: SetRecord, keep: bool = True
) -> Mapping[str, tuple[Member, ...]]:
    """The members of each identity of a shard, its record first, then its views.

    Args:
        keep: the list for the next time, in place of the one that was not asked for the longest.

    Raises:
        InputError: the list is missing, or not the one that index.json speaks of.
    """
    read = _members if keep else _members.__wrapped__
    return read(folder / members_file(shard.file), shard, set_record.views)


@lru_cache(maxsize=_LISTS_KEPT)
def _members(path: Path, shard: ShardRecord, views: int) -> Mapping[str, tuple[Member, ...]]:
    data = read_bytes(path, JSON_LIMIT)
    if hashlib.sha256(data).hexdigest() != shard.members_sha256:
        raise InputError(path, "sha256", "is not the one in index.json", MEND)
    value = parse_json(path, data)
    members = parse_record(path, value, MembersRecord, SHARDS_VERSION, MEND).members
    if tuple(members) != shard.identities:
        raise InputError(path, "identities", "are not those of the shard in index.json", MEND)
    for identity, found in members.items():
        if tuple(member.name for member in found) != member_names(identity, views):
            raise InputError(path, identity, f"has not a record and {views} views", MEND)
    _check_places(path, shard, [member for found in members.values() for member in found])
    return members


def _check_places(path: Path, shard: ShardRecord, members: Sequence[Member]) -> None:
    """Refuse places other than those of one member behind the other, header and padding between."""
    end = 0
    for member in members:
        if member.size > MOST_BYTES:
            raise InputError(path, member.name, f"has {member.size} bytes", MEND)
        start = end + len(member_header(member.name, member.size))
        if member.offset != start:
            raise InputError(path, member.name, f"begins at {member.offset}, not {start}", MEND)
        end = start + member.size + len(padding(member.size))
    if end + len(END) != shard.bytes:
        raise InputError(path, "members", f"take {end + len(END)} of {shard.bytes} bytes", MEND)


def read_member(path: Path, member: Member) -> bytes:
    """The bytes of one member of the tar at `path`.

    Raises:
        InputError: the shard is missing or cut short, or the bytes are not those that were packed.
    """
    return read_members(path, (member,))[0]


def read_members(path: Path, members: tuple[Member, ...]) -> list[bytes]:
    """The bytes of members that lie one behind the other, in one read; see `read_member`."""
    start = members[0].offset
    with disk_errors(path), path.open("rb") as file:
        file.seek(start)
        block = file.read(members[-1].offset + members[-1].size - start)
    found: list[bytes] = []
    for member in members:
        data = block[member.offset - start : member.offset - start + member.size]
        if len(data) < member.size:
            raise cut_short(path, member)
        if hashlib.sha256(data).hexdigest() != member.sha256:
            raise InputError(path, member.name, "is damaged: its sha256 differs", MEND)
        found.append(data)
    return found


def cut_short(path: Path, member: Member) -> InputError:
    """The error of a shard that ends before `member` does."""
    return InputError(path, member.name, "is cut off: the shard ends before it does", MEND)


def parse_identity(path: Path, shard: ShardRecord, member: Member, data: bytes) -> IdentityRecord:
    """The record of an identity from its bytes in a shard.

    Raises:
        InputError: it is no such record, or is not of the split of its shard.
    """
    where = f"{path}: {member.name}"
    record = parse_record(where, parse_json(where, data), IdentityRecord, SET_VERSION, MEND)
    if record.split != shard.split:
        raise InputError(
            where, "split", f"is {record.split!r} in a shard of {shard.split!r}: {record.id} would "
            "be in both splits", "pack the set again",
        )  # fmt: skip
    return record
