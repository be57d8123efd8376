"""Packing a vehicle set into shards: which identity goes into which, and how large they are."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from recast.core import files
from recast.core.errors import InputError
from recast.core.files import disk_errors
from recast.core.progress import Progress, tell
from recast.core.records import read_record
from recast.recar.set_records import (
    IDENTITY_FILE,
    SPLITS,
    SetRecord,
    Split,
    first_difference,
    view_file,
)
from recast.recar.shards.layout import (
    END,
    INDEX_FILE,
    SHARDS_FORMAT,
    SHARDS_VERSION,
    IndexRecord,
    Member,
    MembersRecord,
    ShardRecord,
    member_header,
    member_names,
    members_file,
    padding,
    shard_file,
    stored_bytes,
)
from recast.recar.vehicle_set import Identity, VehicleSet
from recast.recar.views import MOST_BYTES, check_header

SHARD_BYTES = 256 * 10**6

_MEND = "choose another folder, or use the options of the shards in it"


@dataclass(frozen=True)
class PlannedShard:
    """A shard to write: its identities in their order, and the bytes that each takes in it."""

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
        vehicle_set: set in folders.
        shard_bytes: most bytes that a shard may have; an identity that alone takes more has its own
            shard.

    Raises:
        InputError: a file is missing.
    """
    plan: list[PlannedShard] = []
    for split in SPLITS:
        filled = 0
        for identity in sorted(vehicle_set.of_split(split), key=_mixed):
            size = sum(stored_bytes(name, _size(path)) for name, path in members_of(identity))
            if filled == 0 or filled + size > shard_bytes:
                plan.append(PlannedShard(shard_file(len(plan)), split))
                filled = len(END)
            plan[-1].identities.append(identity)
            plan[-1].sizes.append(size)
            filled += size
    return plan


def members_of(identity: Identity) -> list[tuple[str, Path]]:
    """Names in the shard and paths of an identity's files, in the order in which they lie there."""
    views = identity.set_record.views
    files = (IDENTITY_FILE, *(view_file(index) for index in range(views)))
    names = member_names(identity.record.id, views)
    return [(name, identity.folder / file) for name, file in zip(names, files, strict=True)]


def _mixed(identity: Identity) -> bytes:
    return hashlib.sha256(identity.record.id.encode()).digest()


def _size(path: Path) -> int:
    with disk_errors(path):
        return path.stat().st_size


def pack_set(
    vehicle_set: VehicleSet,
    out: str | Path,
    shard_bytes: int = SHARD_BYTES,
    progress: Progress | None = None,
) -> IndexRecord:
    """Write the files of a set, byte for byte, into tar shards.

    Every shard appears whole or not at all. A run that was killed goes on: a shard that is there
    is compared with the set and written anew only where it differs, so that packing again also
    mends a damaged shard. The same set and `shard_bytes` always give the same bytes.

    Args:
        vehicle_set: complete set, in folders.
        out: output folder; new, empty, or shards of the same set and size.
        shard_bytes: most bytes that a shard may have, see `plan_shards`.
        progress: called with pictures done and all pictures.

    Raises:
        InputError: `out` holds something else, a picture is broken or changes while it is read, or
            the disk is full.
    """
    if shard_bytes < 1:
        raise InputError("`shard_bytes`", "value", f"is {shard_bytes}", "give 1 or more")
    out = Path(out)
    _check_out(out, vehicle_set.record, shard_bytes)
    plan = plan_shards(vehicle_set, shard_bytes)
    pictures = len(vehicle_set.identities) * vehicle_set.record.views
    index = IndexRecord(
        complete=False,
        shard_bytes=shard_bytes,
        set=vehicle_set.record,
        identities=len(vehicle_set.identities),
        pictures=pictures,
        bytes=0,
        shards=(),
    )
    _write_index(out, index)
    shards: list[ShardRecord] = []
    done = 0
    with files.alone_in(out):
        for planned in plan:
            shards.append(_write_shard(out, planned, vehicle_set.record))
            done += len(planned.identities) * vehicle_set.record.views
            tell(progress, done, pictures)
        _remove_strangers(out, {shard.file for shard in shards})
    index = index.model_copy(
        update={
            "complete": True,
            "bytes": sum(shard.bytes for shard in shards),
            "shards": tuple(shards),
        }
    )
    _write_index(out, index)
    return index


def _check_out(out: Path, record: SetRecord, shard_bytes: int) -> None:
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not (out / INDEX_FILE).is_file():
        raise InputError(out, "output folder", "exists and holds no shards", "choose a new folder")
    found = read_record(out / INDEX_FILE, IndexRecord, SHARDS_VERSION, _MEND, SHARDS_FORMAT)
    if found.shard_bytes != shard_bytes:
        raise InputError(
            out / INDEX_FILE, "shard_bytes", f"is {found.shard_bytes}, not {shard_bytes}", _MEND
        )
    if name := first_difference(found.set.model_dump(), record.model_dump()):
        problem = "differs: the folder holds shards of another set"
        raise InputError(out / INDEX_FILE, f"set.{name}", problem, _MEND)


def _write_index(out: Path, index: IndexRecord) -> None:
    files.write_json(out / INDEX_FILE, index.model_dump(mode="json"))


def _write_shard(out: Path, planned: PlannedShard, record: SetRecord) -> ShardRecord:
    path = out / planned.file
    writing = _Shard(planned, record)
    if not _already_there(path, writing):
        writing = _Shard(planned, record)
        with files.atomic_file(path) as partial, partial.open("wb") as file:
            for piece in writing.pieces():
                file.write(piece)
    members = MembersRecord(shard=planned.file, members=writing.members)
    text = json.dumps(members.model_dump(mode="json"), separators=(",", ":")) + "\n"
    files.write_text(out / members_file(planned.file), text)
    return ShardRecord(
        file=planned.file,
        split=planned.split,
        bytes=writing.size,
        sha256=writing.digest.hexdigest(),
        members_sha256=hashlib.sha256(text.encode()).hexdigest(),
        identities=tuple(one.record.id for one in planned.identities),
    )


def _already_there(path: Path, writing: _Shard) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return all(file.read(len(piece)) == piece for piece in writing.pieces()) and not file.read(
            1
        )


def _remove_strangers(out: Path, wanted: set[str]) -> None:
    # Of a set whose pictures have become smaller since; a reader that takes all tars of the
    # folder would meet their identities twice.
    with files.disk_errors(out):
        for path in out.glob("shard-*.tar"):
            if path.name not in wanted:
                path.unlink()
                (out / members_file(path.name)).unlink(missing_ok=True)


class _Shard:
    """The bytes of one shard, in pieces; afterwards what has been written, and its hashes."""

    def __init__(self, planned: PlannedShard, record: SetRecord) -> None:
        self._planned, self._record = planned, record
        self.members: dict[str, tuple[Member, ...]] = {}
        self.size = 0
        self.digest = hashlib.sha256()

    def pieces(self) -> Iterator[bytes]:
        for identity, planned in zip(self._planned.identities, self._planned.sizes, strict=True):
            start, written = self.size, list[Member]()
            for name, path in members_of(identity):
                data = _read(path, self._record)
                yield self._counted(member_header(name, len(data)))
                digest = hashlib.sha256(data).hexdigest()
                written.append(Member(name=name, offset=self.size, size=len(data), sha256=digest))
                yield self._counted(data + padding(len(data)))
            if self.size - start != planned:
                raise InputError(
                    identity.folder,
                    "files",
                    "have changed while the set was being packed",
                    "run the command again",
                )
            self.members[identity.record.id] = tuple(written)
        yield self._counted(END)

    def _counted(self, piece: bytes) -> bytes:
        self.size += len(piece)
        self.digest.update(piece)
        return piece


def _read(path: Path, record: SetRecord) -> bytes:
    data = files.read_bytes(path, MOST_BYTES)
    if path.name != IDENTITY_FILE:
        check_header(data, path, record.width, record.height)
    return data


def parse_byte_size(text: str, option: str) -> int:
    """Bytes of a size such as "256MB" (10^6) or "256MiB" (2^20).

    Args:
        text: number and unit.
        option: option with which the user gave the size, for the message.

    Raises:
        InputError: no such unit, less than one byte, or 2^63 and more.
    """
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)\s*(?:(?:([kmgt])(i?))?b)?", text.strip().lower())
    power = " kmgt".index(found[2] or " ") if found else 0
    size = float(found[1]) * (1024 if found[3] else 1000) ** power if found else 0
    if not 1 <= size < 2**63:
        raise InputError(option, "value", f"is {text!r}", "give a size such as 256MB or 1GiB")
    return round(size)
