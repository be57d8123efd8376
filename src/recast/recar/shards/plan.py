"""Which identity goes into which shard."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
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
    size: int


@dataclass(frozen=True)
class PlannedShard:
    """A shard to write: its file name, the split of all in it, and the files of each identity."""

    file: str
    split: Split
    members: dict[str, tuple[PlannedMember, ...]]


def plan_shards(vehicle_set: VehicleSet, shard_bytes: int) -> list[PlannedShard]:
    """Fill one shard after the other; none holds both splits, no identity lies in two.

    Within a split identities are ordered by a hash of their names, so that a shard is a fair sample
    of the set although neighbours by name are often of one kind. Only sizes of files are looked at.

    Args:
        vehicle_set: in folders.
        shard_bytes: that a shard may have; an identity that alone takes more has its own.

    Raises:
        InputError: a file is missing.
    """
    views = vehicle_set.record.views
    plan: list[PlannedShard] = []
    for split in SPLITS:
        filled = 0
        for identity in sorted(vehicle_set.of_split(split), key=_mixed):
            members = _members(identity, views)
            size = sum(stored_bytes(member.name, member.size) for member in members)
            if filled == 0 or filled + size > shard_bytes:
                plan.append(PlannedShard(shard_file(len(plan)), split, {}))
                filled = len(END)
            plan[-1].members[identity.record.id] = members
            filled += size
    return plan


def _mixed(identity: Identity) -> bytes:
    return hashlib.sha256(identity.record.id.encode()).digest()


def _members(identity: Identity, views: int) -> tuple[PlannedMember, ...]:
    files = (IDENTITY_FILE, *(view_file(index) for index in range(views)))
    names = member_names(identity.record.id, views)
    return tuple(
        PlannedMember(name, identity.folder / file, _size(identity.folder / file))
        for name, file in zip(names, files, strict=True)
    )


def _size(path: Path) -> int:
    with disk_errors(path):
        return path.stat().st_size
