"""Vehicle sets: folders with many views of many vehicles, read and written.

    SET/set.json
    SET/ID/identity.json, view_00.png, view_01.png, ...

The same for photographs and for renders; docs/data.md says how to bring one's own. A set is made
one identity after the other, so that a killed run resumes.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, FiniteFloat

from recast.arrays import Array, Image
from recast.cameras import PinholeCamera
from recast.core import files
from recast.core.diagnostics import Progress, tell
from recast.core.errors import InputError
from recast.core.files import disk_errors, read_bytes
from recast.core.records import Record, read_record
from recast.recar.views import (
    HEADER_BYTES,
    LARGEST_SIDE,
    MOST_BYTES,
    Metres,
    Text,
    camera_pose,
    check_header,
    decode_picture,
    encode_picture,
    pinhole,
)

SET_FORMAT = "recast-vehicle-set"
SET_VERSION = 1
SET_FILE = "set.json"
IDENTITY_FILE = "identity.json"
REGULAR_WITHIN_DEG = 1e-3
MOST_VIEWS = 1000
"""Most views of an identity."""

Split = Literal["train", "held-out"]
SPLITS: tuple[Split, ...] = ("train", "held-out")

_MEND = "write the set again; see docs/data.md#vehicle-sets"
_MEND_OUT = "choose another folder, or use the options of the set in it"
_IDENTITY_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
HELD_OUT_SHARE = 0.05
"""648 of 12,896 identities in the paper (section 2)."""


def regular_azimuths(views: int) -> tuple[float, ...]:
    """Azimuths in degrees of `views` cameras evenly around a vehicle, the first one ahead of it."""
    return tuple(360.0 * i / views for i in range(views))


def _check_regular(azimuths: tuple[float, ...]) -> tuple[float, ...]:
    step = 360.0 / len(azimuths)
    for i, azimuth in enumerate(azimuths):
        error = (azimuth - azimuths[0] - i * step + 180.0) % 360.0 - 180.0
        if not 0.0 <= azimuth < 360.0 or abs(error) > REGULAR_WITHIN_DEG:
            raise ValueError(
                f"azimuths are not regular: view {i} at {azimuth:g} degrees, expected "
                f"{(azimuths[0] + i * step) % 360.0:g}"
            )
    return azimuths


def _check_identity_name(name: str) -> str:
    # A file name can be made of it as it stands.
    if not _IDENTITY_NAME.fullmatch(name):
        raise ValueError(
            "expected at most 100 letters, digits, '.', '_' and '-', beginning with a letter "
            "or digit"
        )
    return name


Azimuths = Annotated[
    tuple[FiniteFloat, ...],
    Field(min_length=1, max_length=MOST_VIEWS),
    AfterValidator(_check_regular),
]
IdentityName = Annotated[str, AfterValidator(_check_identity_name)]


class SetRecord(Record):
    """Contents of set.json: what all identities have in common.

    Attributes:
        complete: False while identities are still being added.
        licence: SPDX identifier or words; every use of the pictures needs it.
        identities: number of identities that there are, or will be.
        azimuths_deg: azimuths of the camera about the vehicle, one for each view: 0 ahead of it, 90
            to its left; regular and rising.
        elevation_deg: elevation of the camera above the horizontal through the box centre; None
            where it was not measured.
        fov_deg: angle of view across the image's width; None where it was not measured.
        width, height: width and height of every view, in pixels.
        split_seed, held_out_share: seed and share that decide the split of new identities, see
            `split_of`.
        generator: settings of what made the set; None for photographs.
    """

    format: Literal["recast-vehicle-set"] = "recast-vehicle-set"
    version: int = SET_VERSION
    complete: bool
    name: Text
    licence: Text
    source: Text
    identities: int = Field(ge=1)
    azimuths_deg: Azimuths
    elevation_deg: Annotated[FiniteFloat, Field(gt=-90, lt=90)] | None
    fov_deg: Annotated[FiniteFloat, Field(gt=0, lt=180)] | None
    width: int = Field(ge=1, le=LARGEST_SIDE)
    height: int = Field(ge=1, le=LARGEST_SIDE)
    split_seed: int = Field(ge=0)
    held_out_share: float = Field(ge=0, le=1)
    generator: dict[str, Any] | None

    @property
    def views(self) -> int:
        """Pictures of each identity."""
        return len(self.azimuths_deg)


class IdentityRecord(Record):
    """Contents of identity.json: one vehicle.

    Attributes:
        id: name that is unique in the set; its folder has this name.
        kind: body type, such as "sedan".
        category: category of the label, see `recast.logs.Track`.
        colour: colour name, such as "white".
        size: length, width, height in metres of the box around it; None where not measured.
        distance_m: distance from the camera to the box centre; None where not measured.
        split: split, which says whether it may be trained on.
        source: source of this vehicle, if that is more than the set says: a file, an address.
        seed: seed with which a generator made it; None for photographs.
        licence: licence of this vehicle's pictures, where it is not that of the set.
    """

    version: int = SET_VERSION
    id: IdentityName
    kind: Text
    category: Text
    colour: Text | None
    size: tuple[Metres, Metres, Metres] | None
    distance_m: Metres | None
    split: Split
    source: str | None = None
    seed: tuple[int, ...] | None = None
    licence: Text | None = None


def first_difference(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> str | None:
    """The first name, in their order, whose members of two dumped records differ."""
    names = sorted(found.keys() | wanted.keys())
    return next((name for name in names if found.get(name) != wanted.get(name)), None)


def view_file(index: int) -> str:
    """File name of a view."""
    return f"view_{index:02d}.png"


def split_of(
    identity: str, seed: int, share: float = HELD_OUT_SHARE, index: int | None = None
) -> Split:
    """The split of an identity: a hash of its name and the seed, never of its neighbours.

    So a set that grows keeps the split of every identity it had, and two sets that share a vehicle
    under the same name and seed agree about it.

    Args:
        share: share of identities that are held out, in [0, 1].
        index: its place in a sequence that only ever grows at its end. The first two are set by
            hand, one for training and one held out, so that neither part of a small set is empty.
    """
    if share > 0 and index == 0:
        return "train"
    if share > 0 and index == 1:
        return "held-out"
    digest = hashlib.sha256(f"{seed}/{identity}".encode()).digest()
    return "held-out" if int.from_bytes(digest[:8], "big") < share * 2.0**64 else "train"


@dataclass(frozen=True)
class Identity:
    """One vehicle of a set, its pictures in `folder`; they are decoded when asked for."""

    folder: Path
    record: IdentityRecord
    set_record: SetRecord

    def where(self, index: int) -> Path:
        """Path of a view."""
        return self.folder / view_file(index)

    def encoded(self, index: int) -> bytes:
        """The PNG of a view as it lies on the disk, not looked at; InputError: it is missing."""
        return read_bytes(self.where(index), MOST_BYTES)

    def view(self, index: int) -> Image:
        """(height, width, 4) uint8 RGBA with straight alpha.

        Raises:
            InputError: the picture is missing or broken, of another size, or has no alpha.
        """
        record = self.set_record
        return decode_picture(self.encoded(index), self.where(index), record.width, record.height)

    def check_header(self, index: int) -> None:
        """Look at size and channels of a view without decoding it; raises as `check_header`."""
        path, record = self.where(index), self.set_record
        with disk_errors(path), path.open("rb") as file:
            head = file.read(HEADER_BYTES)
        check_header(head, path, record.width, record.height)

    def picture_bytes(self) -> int:
        """Bytes of all its pictures."""
        with disk_errors(self.folder):
            return sum(self.where(i).stat().st_size for i in range(self.set_record.views))

    def camera(self, index: int) -> tuple[PinholeCamera, Array]:
        """The camera of a view, and `actor_from_camera` (4, 4).

        Raises:
            IndexError: no such view.
            ValueError: elevation, angle of view or distance was not measured.
        """
        shared, name = self.set_record, self.record.id
        if not 0 <= index < shared.views:
            raise IndexError(f"view {index}: {name} has views 0 to {shared.views - 1}")
        elevation, fov, distance = shared.elevation_deg, shared.fov_deg, self.record.distance_m
        if elevation is None or fov is None or distance is None:
            raise ValueError(
                f"{name}: no camera without elevation ({elevation}), fov ({fov}) and distance "
                f"({distance})"
            )
        pose = camera_pose(shared.azimuths_deg[index], elevation, distance)
        return pinhole(shared.width, shared.height, fov), pose


@dataclass(frozen=True)
class VehicleSet:
    """A set that was read; `identities` are by id, sorted."""

    folder: Path
    record: SetRecord
    identities: dict[str, Identity]

    def of_split(self, split: Split) -> Iterator[Identity]:
        """The identities of one split, sorted."""
        return (one for one in self.identities.values() if one.record.split == split)

    def check_pictures(self, decode: bool = False, progress: Progress | None = None) -> None:
        """Look at every picture: its header, or all of it.

        Args:
            decode: also find pictures cut short and alpha that is zero everywhere; slow.

        Raises:
            InputError: the first picture that is wrong.
        """
        views, done = self.record.views, 0
        for identity in self.identities.values():
            for index in range(views):
                if decode:
                    identity.view(index)
                else:
                    identity.check_header(index)
                done += 1
                tell(progress, done, views * len(self.identities))


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
        mend = "run the command that makes it again; it resumes"
        raise InputError(folder / SET_FILE, "complete", "is false: the set is not complete", mend)
    identities = read_identities(folder, record)
    if len(identities) != record.identities:
        problem = f"{len(identities)} folders, but set.json counts {record.identities}"
        mend = "restore the missing ones, or correct set.json"
        raise InputError(folder, "identities", problem, mend)
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
            first = identities[one.id]
            how = "the set twice" if first.record.split == one.split else "both splits"
            problem = f"{one.id} is in {how}, also as {first.folder.name}"
            raise InputError(path / IDENTITY_FILE, "id", problem, "keep one of the two folders")
        identities[one.id] = found
    for identity in identities.values():
        _check_folder(identity)
    return dict(sorted(identities.items()))


def _check_folder(identity: Identity) -> None:
    if identity.folder.name != identity.record.id:
        problem = f"is {identity.record.id!r} in the folder {identity.folder.name!r}"
        mend = "name the folder after the identity"
        raise InputError(identity.folder / IDENTITY_FILE, "id", problem, mend)
    present = {path.name for path in identity.folder.iterdir()}
    for index in range(identity.set_record.views):
        if view_file(index) not in present:
            mend = f"every identity needs all {identity.set_record.views} views"
            raise InputError(identity.folder / view_file(index), "view", "is missing", mend)


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
        mend = "choose a new or empty folder"
        raise InputError(folder, "output folder", "exists and is not a vehicle set", mend)
    found = read_set_record(folder)
    if name := first_difference(_members(found), _members(record)):
        problem = "differs: the folder holds a set of another configuration"
        raise InputError(folder / SET_FILE, name, problem, _MEND_OUT)
    finished = read_identities(folder, found)
    if unwanted := sorted(finished.keys() - set(identities)):
        problem = f"is in the folder but not among the {len(identities)} requested"
        raise InputError(folder, unwanted[0], problem, _MEND_OUT)
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
