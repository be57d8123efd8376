"""A folder of shards: its names and records, the tars, and their members checked by their hash."""

from __future__ import annotations

import hashlib
import tarfile
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from recast.core.errors import InputError
from recast.core.files import JSON_LIMIT, disk_errors, parse_json, read_bytes
from recast.core.records import Record, parse_record
from recast.recar.set_records import (
    IDENTITY_FILE,
    SET_VERSION,
    IdentityName,
    IdentityRecord,
    SetRecord,
    Split,
    view_file,
)
from recast.recar.views import MOST_BYTES

SHARDS_FORMAT = "recast-vehicle-shards"
SHARDS_VERSION = 1
INDEX_FILE = "index.json"
MEND = "copy the shards again, or pack the set again"

Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Count = Annotated[int, Field(ge=0, lt=2**63)]
BLOCK = 512
END = bytes(2 * BLOCK)
"""Closes every archive."""
_LISTS_KEPT = 128  # of members, of the paper's pictures about 1 MB each in memory


class ShardRecord(Record):
    """One shard in index.json.

    Attributes:
        file: file name of the tar.
        split: split of all identities in it.
        bytes, sha256: size in bytes and SHA-256 of the tar.
        members_sha256: SHA-256 of the list of its members.
        identities: identities in the order in which they lie in it.
    """

    file: Annotated[str, Field(pattern=r"^shard-[0-9]{6,}\.tar$")]
    split: Split
    bytes: Count
    sha256: Sha256
    members_sha256: Sha256
    identities: tuple[IdentityName, ...] = Field(min_length=1)


class IndexRecord(Record):
    """Contents of index.json.

    Attributes:
        complete: False while shards are still being written.
        shard_bytes: size in bytes that no shard exceeds, unless one identity alone does.
        set: set.json of the set that was packed.
        identities, pictures, bytes: counts over all shards.
        shards: records of the shards, the training ones first.
    """

    format: Literal["recast-vehicle-shards"] = "recast-vehicle-shards"
    version: int = SHARDS_VERSION
    complete: bool
    shard_bytes: int = Field(ge=1, lt=2**63)
    set: SetRecord
    identities: Count
    pictures: Count
    bytes: Count
    shards: tuple[ShardRecord, ...]


class Member(Record):
    """One file in a shard: its name, where its bytes begin, how many they are, and their hash."""

    name: str
    offset: Count
    size: Count
    sha256: Sha256


class MembersRecord(Record):
    """Contents of shard-000000.members.json: the files of each identity in the tar's order."""

    version: int = SHARDS_VERSION
    shard: str
    members: dict[IdentityName, tuple[Member, ...]]


def shard_file(number: int) -> str:
    """File name of a shard."""
    return f"shard-{number:06d}.tar"


def members_file(shard: str) -> str:
    """File name of the list of a shard's members."""
    return f"{Path(shard).stem}.members.json"


def member_names(identity: str, views: int) -> tuple[str, ...]:
    """Names of an identity's files in a shard, its record first.

    A sample in WebDataset is what has the same name up to the first dot, so dots in the name of an
    identity are written as %2E.
    """
    key = identity.replace(".", "%2E")
    files = (IDENTITY_FILE, *(view_file(index) for index in range(views)))
    return tuple(f"{key}.{file}" for file in files)


def member_header(name: str, size: int) -> bytes:
    """Header of a regular file: no owner, no time; POSIX ustar, with pax only for long names."""
    info = tarfile.TarInfo(name)
    info.size, info.mode, info.mtime = size, 0o644, 0
    return info.tobuf(tarfile.PAX_FORMAT, "utf-8", "strict")


def padding(size: int) -> bytes:
    """Zeros that bring a member's bytes to whole blocks."""
    return bytes(-size % BLOCK)


def stored_bytes(name: str, size: int) -> int:
    """What a member takes in the archive: header, bytes and padding."""
    return len(member_header(name, size)) + size + len(padding(size))


def shard_members(
    folder: Path, shard: ShardRecord, set_record: SetRecord, keep: bool = True
) -> Mapping[str, tuple[Member, ...]]:
    """The members of each identity of a shard, its record first, then its views.

    `keep` caches the list, in place of the one that was not asked for the longest.

    Raises:
        InputError: the list is missing, or not the one that index.json speaks of.
    """
    read = _members if keep else _members.__wrapped__
    return read(folder / members_file(shard.file), shard, set_record.views)


@lru_cache(maxsize=_LISTS_KEPT)
def _members(path: Path, shard: ShardRecord, views: int) -> Mapping[str, tuple[Member, ...]]:
    data = read_bytes(path, JSON_LIMIT)
    if hashlib.sha256(data).hexdigest() != shard.members_sha256:
        raise InputError(path, "sha256", "differs from the one in index.json", MEND)
    value = parse_json(path, data)
    members = parse_record(path, value, MembersRecord, SHARDS_VERSION, MEND).members
    if tuple(members) != shard.identities:
        raise InputError(path, "identities", "differ from those in index.json", MEND)
    for identity, found in members.items():
        if tuple(member.name for member in found) != member_names(identity, views):
            raise InputError(path, identity, f"does not have a record and {views} views", MEND)
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
        raise InputError(path, "members", f"end at byte {end + len(END)} of {shard.bytes}", MEND)


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
    return InputError(path, member.name, "is cut off at the end of the shard", MEND)


def parse_identity(path: Path, shard: ShardRecord, member: Member, data: bytes) -> IdentityRecord:
    """The record of an identity from its bytes in a shard.

    Raises:
        InputError: it is no such record, or is not of the split of its shard.
    """
    where = f"{path}: {member.name}"
    record = parse_record(where, parse_json(where, data), IdentityRecord, SET_VERSION, MEND)
    if record.split != shard.split:
        raise InputError(
            where,
            "split",
            f"is {record.split!r} in a shard of {shard.split!r}: {record.id} would "
            "be in both splits",
            "pack the set again",
        )
    return record
