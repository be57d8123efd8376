"""Which identity goes into which shard."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path

from recast.recar.record import IDENTITY_FILE, SPLITS, Split, view_file
from recast.recar.shards.layout import member_names, shard_file
from recast.recar.shards.tar import END, stored_bytes
from recast.recar.vehicle_set import Identity, VehicleSet
from recast.storage import disk_errors


@dataclass(frozen=True)
class PlannedMember:
    """A file of the set, and what it is called in the shard."""

    name: str
    path: Path


@dataclass(frozen=True)
class PlannedShard:
    """A shard to write.

    Attributes:
        file: its name.
        split: of all identities in it.
        identities: in the order in which they lie in it.
        sizes: bytes that each of them takes in the archive.
    """

    file: str
    split: Split
    identities: list[Identity] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)


def plan_shards(vehicle_set: VehicleSet, shard_bytes: int) -> list[PlannedShard]:
    """Fill one shard after the other; none holds both splits, no identity lies in two.

    Within a split identities are ordered by a hash of their names, so that a shard is a fair sample
    of the set although neighbours by name are often of one kind. Only sizes of files are looked at,
    and one number is kept of each identity.

    Args:
        vehicle_set: in folders.
        shard_bytes: that a shard may have; an identity that alone takes more has its own.

    Raises:
        InputError: a file is missing.
    """
    plan: list[PlannedShard] = []
    for split in SPLITS:
        filled = 0
        for identity in sorted(vehicle_set.of_split(split), key=_mixed):
            size = sum(
                stored_bytes(member.name, _size(member.path)) for member in members_of(identity)
            )
            if filled == 0 or filled + size > shard_bytes:
                plan.append(PlannedShard(shard_file(len(plan)), split))
                filled = len(END)
            plan[-1].identities.append(identity)
            plan[-1].sizes.append(size)
            filled += size
    return plan


def members_of(identity: Identity) -> tuple[PlannedMember, ...]:
    """The files of an identity in the order in which they lie in a shard."""
    views = identity.set_record.views
    files = (IDENTITY_FILE, *(view_file(index) for index in range(views)))
    names = member_names(identity.record.id, views)
    return tuple(
        PlannedMember(name, identity.folder / file) for name, file in zip(names, files, strict=True)
    )


def _mixed(identity: Identity) -> bytes:
    return hashlib.sha256(identity.record.id.encode()).digest()


def _size(path: Path) -> int:
    with disk_errors(path):
        return path.stat().st_size
