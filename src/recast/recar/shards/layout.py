"""Names and records of a folder of shards."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from recast.recar.record import IDENTITY_FILE, IdentityName, SetRecord, Split, view_file
from recast.records import Record

SHARDS_FORMAT = "recast-vehicle-shards"
SHARDS_VERSION = 1
INDEX_FILE = "index.json"
MEND = "copy the shards again, or pack the set again"

Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Count = Annotated[int, Field(ge=0, lt=2**63)]


class ShardRecord(Record):
    """One shard in index.json.

    Attributes:
        file: name of the tar.
        split: of all identities in it.
        bytes, sha256: of the tar.
        members_sha256: of the list of its members.
        identities: in the order in which they lie in it.
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
        shard_bytes: that no shard exceeds, unless one identity alone does.
        set: set.json of the set that was packed.
        identities, pictures, bytes: counts over all shards.
        shards: the training ones first.
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
