"""Vehicle sets: folders with many views of many vehicles, read and written.

    SET/set.json
    SET/ID/identity.json, view_00.png, view_01.png, ...

The same for photographs and for renders; docs/data.md says how to bring one's own. A set is made
one identity after the other, so that a killed run resumes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recast.core import files
from recast.core.errors import InputError
from recast.core.files import disk_errors, read_bytes
from recast.core.records import read_record
from recast.recar.set_records import (
    IDENTITY_FILE,
    SET_FILE,
    SET_FORMAT,
    SET_VERSION,
    IdentityRecord,
    SetRecord,
    Split,
    first_difference,
    view_file,
)
from recast.recar.views import (
    HEADER_BYTES,
    MOST_BYTES,
    IdentitySource,
    Image,
    VehicleSource,
    encode_picture,
)

_MEND = "write the set again; see docs/data.md#vehicle-sets"
_MEND_OUT = "choose another folder, or use the options of the set in it"


@dataclass(frozen=True)
class Identity(IdentitySource):
    """One vehicle of a set, its pictures in `folder`."""

    folder: Path
    record: IdentityRecord
    set_record: SetRecord

    def where(self, index: int) -> Path:
        """Path of a view."""
        return self.folder / view_file(index)

    def encoded(self, index: int) -> bytes:
        """The PNG of a view as it lies on the disk, not looked at; InputError: it is missing."""
        return read_bytes(self.where(index), MOST_BYTES)

    def head(self, index: int) -> bytes:
        """The first bytes of a view."""
        path = self.where(index)
        with disk_errors(path), path.open("rb") as file:
            return file.read(HEADER_BYTES)

    def picture_bytes(self) -> int:
        """Bytes of all its pictures."""
        with disk_errors(self.folder):
            return sum(self.where(i).stat().st_size for i in range(self.set_record.views))


@dataclass(frozen=True)
class VehicleSet(VehicleSource):
    """A set in folders that was read."""

    folder: Path
    record: SetRecord
    identities: dict[str, Identity]

    def of_split(self, split: Split) -> Iterator[Identity]:
        """The identities of one split, sorted."""
        return (one for one in self.identities.values() if one.record.split == split)

    def records(self) -> Iterator[tuple[IdentityRecord, int]]:
        """Record and bytes of the pictures of every identity, sorted by id."""
        return ((one.record, one.picture_bytes()) for one in self.identities.values())


def read_set(folder: str | Path) -> VehicleSet:
    """Read the records of a set; pictures are only looked for, see `VehicleSet.check_pictures`.

    Raises:
        InputError: no such set or one in the making, a record with missing, unknown or wrong
            members, azimuths not regular, a view missing, an identity twice or in both splits, or
            not as many identities as set.json says.
    """
    folder = Path(folder)
    record = read_set_record(folder)
    if not record.complete:
        raise InputError(
            folder / SET_FILE,
            "complete",
            "is false: the set is not complete",
            "run the command that makes it again; it resumes",
        )
    identities = read_identities(folder, record)
    if len(identities) != record.identities:
        raise InputError(
            folder,
            "identities",
            f"{len(identities)} folders, but set.json counts {record.identities}",
            "restore the missing ones, or correct set.json",
        )
    return VehicleSet(folder, record, identities)


def read_set_record(folder: Path) -> SetRecord:
    """Read set.json, of a set in the making too."""
    if not folder.is_dir():
        raise InputError(folder, "vehicle set", "is missing", "check the path")
    return read_record(folder / SET_FILE, SetRecord, SET_VERSION, _MEND, SET_FORMAT)


def read_identities(folder: Path, record: SetRecord) -> dict[str, Identity]:
    """The finished identities of a set, by id; see `read_set` for what is wrong with them."""
    identities: dict[str, Identity] = {}
    # Names that begin with a dot are identities that a killed run left unfinished.
    for path in sorted(p for p in folder.iterdir() if p.is_dir() and p.name[0] != "."):
        one = read_record(path / IDENTITY_FILE, IdentityRecord, SET_VERSION, _MEND)
        found = Identity(path, one, record)
        if one.id in identities:
            _refuse_twice(identities[one.id], found)
        identities[one.id] = found
    for identity in identities.values():
        _check_folder(identity)
    return dict(sorted(identities.items()))


def _refuse_twice(first: Identity, second: Identity) -> None:
    splits = {first.record.split, second.record.split}
    raise InputError(
        second.folder / IDENTITY_FILE,
        "id",
        f"{second.record.id} is in {'both splits' if len(splits) == 2 else 'the set twice'}, "
        f"also as {first.folder.name}",
        "keep one of the two folders",
    )


def _check_folder(identity: Identity) -> None:
    if identity.folder.name != identity.record.id:
        raise InputError(
            identity.folder / IDENTITY_FILE,
            "id",
            f"is {identity.record.id!r} in the folder {identity.folder.name!r}",
            "name the folder after the identity",
        )
    present = {path.name for path in identity.folder.iterdir()}
    for index in range(identity.set_record.views):
        if view_file(index) not in present:
            raise InputError(
                identity.folder / view_file(index),
                "view",
                "is missing",
                f"every identity needs all {identity.set_record.views} views",
            )


def begin_set(folder: str | Path, record: SetRecord, identities: Collection[str]) -> frozenset[str]:
    """Start a set, or go on with the one that lies there; see `check_begin`.

    It is marked as in the making until `finish_set`. The one there may have fewer identities than
    `identities`, the ids of all that will be in it. Returns the ids that are finished already.

    Raises:
        InputError: as `check_begin`.
    """
    folder = Path(folder)
    finished = check_begin(folder, record, identities)
    with files.disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    if len(finished) < len(identities):
        _write_record(folder, record.model_copy(update={"complete": False}))
    return finished


def check_begin(folder: Path, record: SetRecord, identities: Collection[str]) -> frozenset[str]:
    """Ids of a set that are finished, of those that will be in it; nothing is written.

    Raises:
        InputError: the folder holds something else, a set of another configuration, a broken
            identity or one that is not among `identities`.
    """
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return frozenset()
    if not (folder / SET_FILE).is_file():
        raise InputError(
            folder,
            "output folder",
            "exists and is not a vehicle set",
            "choose a new or empty folder",
        )
    found = read_set_record(folder)
    if name := first_difference(_members(found), _members(record)):
        raise InputError(
            folder / SET_FILE,
            name,
            "differs: the folder holds a set of another configuration",
            _MEND_OUT,
        )
    finished = read_identities(folder, found)
    if unwanted := sorted(finished.keys() - set(identities)):
        raise InputError(
            folder,
            unwanted[0],
            f"is in the folder but not among the {len(identities)} requested",
            _MEND_OUT,
        )
    return frozenset(finished)


def write_identity(
    folder: str | Path, record: SetRecord, identity: IdentityRecord, pictures: Iterable[Image]
) -> None:
    """Add one identity to a set; its folder appears whole or not at all.

    Args:
        pictures: one for each azimuth, (height, width, 4) uint8 RGBA with straight alpha; taken
            one by one.

    Raises:
        ValueError: not one picture a view, of another shape, or with alpha zero everywhere.
        InputError: the identity is there already, or the disk is full.
    """
    with files.atomic_folder(Path(folder) / identity.id) as partial:
        count = 0
        for index, picture in enumerate(pictures):
            if picture.shape != (record.height, record.width, 4) or not picture[..., 3].any():
                raise ValueError(
                    f"{identity.id}: view {index}: shape {picture.shape}, or transparent everywhere"
                )
            (partial / view_file(index)).write_bytes(encode_picture(picture))
            count += 1
        if count != record.views:
            raise ValueError(f"{identity.id}: {count} images, expected {record.views}")
        files.write_json(partial / IDENTITY_FILE, identity.model_dump(mode="json"))


def finish_set(folder: str | Path, record: SetRecord) -> None:
    """Mark a set as complete."""
    _write_record(Path(folder), record.model_copy(update={"complete": True}))


def _members(record: SetRecord) -> dict[str, Any]:
    members = record.model_dump(mode="json", exclude={"complete", "identities", "generator"})
    return {**members, **(record.generator or {})}


def _write_record(folder: Path, record: SetRecord) -> None:
    files.write_json(folder / SET_FILE, record.model_dump(mode="json"))
