"""The records of a vehicle set, set.json and identity.json of every vehicle, and its split."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, FiniteFloat

from recast.core.records import Record

SET_FORMAT = "recast-vehicle-set"
SET_VERSION = 1
SET_FILE = "set.json"
IDENTITY_FILE = "identity.json"
REGULAR_WITHIN_DEG = 1e-3
LARGEST_SIDE = 8192
"""Longest side of a picture of a set, pixels: decoded, it takes 268 MB at most."""
MOST_VIEWS = 1000
"""Most views of an identity."""

Split = Literal["train", "held-out"]
SPLITS: tuple[Split, ...] = ("train", "held-out")

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


def is_identity_name(name: str) -> bool:
    """Whether an identity may have this name, of which a file name can be made as it stands."""
    return _IDENTITY_NAME.fullmatch(name) is not None


def _check_identity_name(name: str) -> str:
    if not is_identity_name(name):
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
Text = Annotated[str, Field(min_length=1)]
Metres = Annotated[FiniteFloat, Field(gt=0)]


class SetRecord(Record):
    """Contents of set.json: what all identities have in common.

    Attributes:
        complete: False while identities are still being added.
        licence: SPDX identifier or words; every use of the pictures needs it.
        source: source of the pictures, for people.
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
        identity: name of the identity.
        seed: seed of the split.
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
