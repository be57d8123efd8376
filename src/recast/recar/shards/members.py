"""Reading the members of a shard: only those asked for, and never without a look at their hash."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from recast.errors import InputError
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
from recast.records import parse_record

_LISTS_KEPT = 128  # of members, about 100 KB each


def shard_members(
    folder: Path, shard: ShardRecord, set_record: SetRecord
) -> Mapping[str, tuple[Member, ...]]:
    """The members of each identity of a shard, its record first, then its views.

    Raises:
        InputError: the list is missing, or not the one that index.json speaks of.
    """
    return _members(folder / members_file(shard.file), shard, set_record.views)


@lru_cache(maxsize=_LISTS_KEPT)
def _members(path: Path, shard: ShardRecord, views: int) -> Mapping[str, tuple[Member, ...]]:
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(path, "list of members", "is missing", MEND) from None
    if hashlib.sha256(data).hexdigest() != shard.members_sha256:
        raise InputError(path, "sha256", "is not the one in index.json", MEND)
    members = parse_record(path, json.loads(data), MembersRecord, SHARDS_VERSION, MEND).members
    if tuple(members) != shard.identities:
        raise InputError(path, "identities", "are not those of the shard in index.json", MEND)
    for identity, found in members.items():
        if tuple(member.name for member in found) != member_names(identity, views):
            raise InputError(path, identity, f"has not a record and {views} views", MEND)
    return members


def read_member(path: Path, member: Member) -> bytes:
    """The bytes of one member of the tar at `path`.

    Raises:
        InputError: the shard is missing or cut short, or the bytes are not those that were packed.
    """
    return read_members(path, (member,))[0]


def read_members(path: Path, members: tuple[Member, ...]) -> list[bytes]:
    """The bytes of members that lie one behind the other, in one read; see `read_member`."""
    start = members[0].offset
    try:
        with path.open("rb") as file:
            file.seek(start)
            block = file.read(members[-1].offset + members[-1].size - start)
    except FileNotFoundError:
        raise InputError(path, "shard", "is missing", MEND) from None
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
    try:
        value = json.loads(data)
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(where, "JSON", f"cannot be read ({error})", MEND) from None
    record = parse_record(where, value, IdentityRecord, SET_VERSION, MEND)
    if record.split != shard.split:
        raise InputError(
            where, "split", f"is {record.split!r} in a shard of {shard.split!r}: {record.id} would "
            "be in both splits", "pack the set again",
        )  # fmt: skip
    return record
