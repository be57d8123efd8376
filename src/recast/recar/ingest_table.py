"""What is known of photographs: settings that all vehicles share, and the table of vehicles."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, FiniteFloat, ValidationError, model_validator

from recast.core import files
from recast.core.errors import InputError, require_range
from recast.core.records import Record, validation_error
from recast.recar.vehicle_set import (
    HELD_OUT_SHARE,
    MOST_VIEWS,
    IdentityName,
    SetRecord,
    Split,
    regular_azimuths,
)
from recast.recar.views import LARGEST_SIDE, Metres, Text

BITS = 255
DUPLICATE_BITS = 20
"""Hashes that differ in no more bits are of one picture. Measured on renders of synthetic vehicles:
views of one vehicle 12 degrees apart differ in 68 bits at least, 3 degrees apart in 22; views of
different vehicles in 48. The same view scaled by half and compressed to JPEG of quality 60 differs
in 4 bits by the median, but in up to 54 where a vehicle is one flat dark surface: such copies are
missed rather than good vehicles lost."""


MOST_BYTES = 1 << 26
"""Most bytes of a table."""
OVERFLOW = "more cells than columns"
"""Name of what a row has beyond the columns."""
TABLES = ("vehicles.csv", "vehicles.json")
_MEND = "correct it; see docs/recar.md#sets"


@dataclass(frozen=True)
class WalkaroundLayout:
    """A data set of walk-arounds.

    Attributes:
        width, height: width and height of the published photographs in pixels, either way up.
    """

    title: str
    width: int
    height: int


LAYOUTS: Mapping[str, WalkaroundLayout | None] = {
    "regular": None,
    "3drealcar": WalkaroundLayout("3DRealCar", 1920, 1440),
    "mad-cars": WalkaroundLayout("MAD-CARS", 1920, 1080),
}
"""By the word of the command line; None where photographs are regular, see `photographs_of`. Those
of walk-arounds have not met real data."""


@dataclass(frozen=True)
class IngestSettings:
    """Settings of a set of photographs.

    Attributes:
        licence: licence of the pictures; also that of a vehicle whose row names none.
        width, height: width and height of every picture in the set, in pixels.
        clockwise: whether the photographs go around the vehicle clockwise, seen from above.
        elevation_deg: elevation of the camera, where it was measured.
        fov_deg: angle of view across the width of a photograph, where it was measured; all
            photographs must then have the shape of the set's pictures.
        split_seed, held_out_share: seed and share that decide the split of vehicles whose row names
            none.
        duplicate_bits: number of bits; two pictures whose hashes differ in no more bits are the
            same one.
        layout: layout of the photographs, one of `LAYOUTS`; all but "regular" are walk-arounds.
        azimuth_within_deg: degrees by which a photograph of a walk-around may be off its azimuth;
            half of the step between two views where it is None.
    """

    licence: str
    source: str = "photographs"
    views: int = 30
    width: int = 1200
    height: int = 800
    clockwise: bool = False
    elevation_deg: float | None = None
    fov_deg: float | None = None
    split_seed: int = 0
    held_out_share: float = HELD_OUT_SHARE
    duplicate_bits: int = DUPLICATE_BITS
    layout: str = "regular"
    azimuth_within_deg: float | None = None

    def validate(self) -> None:
        """Refuse impossible values.

        Raises:
            InputError: the first one, named as the option of the command line.
        """
        require_range(1, MOST_VIEWS, views=self.views)
        require_range(16, LARGEST_SIDE, width=self.width, height=self.height)
        require_range(-89, 89, elevation=self.elevation_deg)
        require_range(1, 170, fov=self.fov_deg)
        require_range(0, 2**63, split_seed=self.split_seed)
        require_range(0, 1, held_out=self.held_out_share)
        require_range(0, BITS, duplicate_bits=self.duplicate_bits)
        require_range(0, 180, azimuth_within=self.azimuth_within_deg)
        if self.layout not in LAYOUTS:
            mend = f"choose one of {', '.join(LAYOUTS)}"
            raise InputError("`layout`", self.layout, "is unknown", mend)
        for option, text in (("`licence`", self.licence), ("`source`", self.source)):
            if not text.strip():
                raise InputError(option, "value", "is empty", "describe it in words")

    @property
    def azimuth_within(self) -> float:
        """Degrees by which a photograph of a walk-around may be off its azimuth."""
        return 180 / self.views if self.azimuth_within_deg is None else self.azimuth_within_deg

    def record(self, name: str, identities: int) -> SetRecord:
        """The record of the finished set."""
        return SetRecord(
            complete=True,
            name=name,
            licence=self.licence,
            source=self.source,
            identities=identities,
            azimuths_deg=regular_azimuths(self.views),
            elevation_deg=self.elevation_deg,
            fov_deg=self.fov_deg,
            width=self.width,
            height=self.height,
            split_seed=self.split_seed,
            held_out_share=self.held_out_share,
            generator=None,
        )


class VehicleRow(Record):
    """What is known about one vehicle.

    Attributes:
        folder: folder with its photographs, where it is not named by the id.
        kind: body type, such as "sedan".
        length_m, width_m, height_m: length, width and height of its box; all or none.
        distance_m: distance from the camera to the box centre.
        split: split of the vehicle, where it must not be drawn by the hash.
        source, licence: source and licence of its pictures, where they are not those of the set.
        front: number of the photograph, counted from 1, that shows its front.
        azimuths_deg: azimuths of the photographs, where they were measured.
    """

    id: IdentityName
    folder: Text | None = None
    kind: Text
    category: Text = "car"
    colour: Text | None = None
    length_m: Metres | None = None
    width_m: Metres | None = None
    height_m: Metres | None = None
    distance_m: Metres | None = None
    split: Split | None = None
    source: Text | None = None
    licence: Text | None = None
    front: int = Field(default=1, ge=1)
    azimuths_deg: Annotated[tuple[FiniteFloat, ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _check_size(self) -> VehicleRow:
        given = [self.length_m, self.width_m, self.height_m]
        if None in given and any(given):
            raise ValueError("give all of length_m, width_m, height_m or none")
        return self

    @property
    def size(self) -> tuple[float, float, float] | None:
        """Length, width, height in metres."""
        if self.length_m is None or self.width_m is None or self.height_m is None:
            return None
        return self.length_m, self.width_m, self.height_m


def read_table(path: Path) -> tuple[list[VehicleRow], dict[str, InputError]]:
    """All vehicles of a table, and its bad rows by the name of their vehicle.

    Raises:
        InputError: the file cannot be read at all, or holds no vehicle.
    """
    rows, bad = [], {}
    raw = _raw_rows(path)
    ids = [value.get("id", "") for _, value in raw]
    names = [one if isinstance(one, str) else "" for one in ids]
    for (where, value), name in zip(raw, names, strict=True):
        try:
            rows.append(VehicleRow.model_validate(value))
        except ValidationError as error:
            bad[name or where] = validation_error(where, error, _MEND)
    twice = {name: count for name, count in Counter(names).items() if name and count > 1}
    rows = [row for row in rows if row.id not in twice]
    for name, count in twice.items():
        bad[name] = InputError(path, name, f"has {count} rows", "keep one of the rows")
    if not rows and not bad:
        raise InputError(path, "vehicles", "are missing", "write a row for each folder")
    return rows, bad


def find_table(photos: Path) -> Path:
    """vehicles.csv or vehicles.json beside the folders.

    Raises:
        InputError: neither or both are there.
    """
    found = [photos / name for name in TABLES if (photos / name).is_file()]
    if len(found) != 1:
        raise InputError(
            photos,
            " or ".join(TABLES),
            "both exist" if found else "is missing",
            "write one file with at least id and kind of each vehicle, or give its path as `table`",
        )
    return found[0]


def _raw_rows(path: Path) -> list[tuple[str, dict[str, Any]]]:
    if path.suffix.lower() == ".json":
        value = files.read_json(path)
        if not isinstance(value, list) or not all(isinstance(row, dict) for row in value):
            raise InputError(path, "JSON", "is not a list of objects", _MEND)
        return [(f"{path}: entry {place}", row) for place, row in enumerate(value, 1)]
    heading, rows = csv_rows(path, _MEND)
    if problem := _heading_fault(heading):
        raise InputError(path, "heading", problem, _MEND)
    found: list[tuple[str, dict[str, Any]]] = []
    for where, cells in rows:
        azimuths = cells.get("azimuths_deg")
        found.append(
            (where, cells if azimuths is None else cells | {"azimuths_deg": azimuths.split()})
        )
    return found


def csv_rows(path: Path, mend: str) -> tuple[tuple[str, ...], list[tuple[str, dict[str, str]]]]:
    """Names of the columns of a CSV file; and of each row its place, and cells that are not empty.

    Commas or semicolons separate. Cells beyond the columns are under `OVERFLOW`.

    Raises:
        InputError: the file cannot be read, is not UTF-8 or no CSV.
    """
    text = files.read_text(path, MOST_BYTES).removeprefix("\ufeff")
    first = text.partition("\n")[0]
    reader = csv.DictReader(io.StringIO(text, newline=""), delimiter=";" if ";" in first else ",")
    try:
        heading = tuple(name.strip() for name in reader.fieldnames or ())
        return heading, [(f"{path}: line {reader.line_num}", _cells(row)) for row in reader]
    except csv.Error as error:  # such as a cell of more than 131,072 characters
        raise InputError(path, f"line {reader.line_num + 1}", str(error), mend) from None


def _heading_fault(names: Sequence[str]) -> str | None:
    if unknown := set(names) - VehicleRow.model_fields.keys():
        return f"{min(unknown)!r} is not a column"
    if not {"id", "kind"} <= set(names):
        return "id and kind are needed"
    return "names a column twice" if len(set(names)) < len(names) else None


def _cells(row: dict[str | None, Any]) -> dict[str, str]:
    named = {name.strip(): value for name, value in row.items() if name is not None}
    filled = {name: value.strip() for name, value in named.items() if value and value.strip()}
    if None in row:
        filled[OVERFLOW] = str(row[None])
    return filled
