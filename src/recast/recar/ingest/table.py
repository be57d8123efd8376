"""The table of vehicles that comes with the photographs: vehicles.csv or vehicles.json."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, FiniteFloat, ValidationError, model_validator

from recast import storage
from recast.errors import InputError
from recast.recar.record import IdentityName, Metres, Split, Text
from recast.records import Record, validation_error

MOST_BYTES = 1 << 26
"""Most bytes of a table."""
TABLES = ("vehicles.csv", "vehicles.json")
_MEND = "correct the row; docs/data.md lists the columns"


class VehicleRow(Record):
    """What is known about one vehicle.

    Attributes:
        id: its name in the set.
        folder: with its photographs, where it is not named by the id.
        kind: body type, such as "sedan".
        category: as in logs.
        colour: name.
        length_m, width_m, height_m: of its box; all or none.
        distance_m: camera to box centre.
        split: where it must not be drawn by the hash.
        source, licence: where they are not those of the set.
        front: which photograph, counted from 1, shows its front.
        azimuths_deg: of the photographs, where they were measured.
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
        bad[name] = InputError(path, name, f"has {count} rows", "keep one of them")
    if not rows and not bad:
        raise InputError(path, "vehicles", "are none", "write a row for each folder")
    return rows, bad


def find_table(photos: Path) -> Path:
    """vehicles.csv or vehicles.json beside the folders.

    Raises:
        InputError: neither or both are there.
    """
    found = [photos / name for name in TABLES if (photos / name).is_file()]
    if len(found) != 1:
        raise InputError(
            photos, " or ".join(TABLES), "are both there" if found else "is missing",
            "write one of them, with at least id and kind of each vehicle, or name it by --table",
        )  # fmt: skip
    return found[0]


def _raw_rows(path: Path) -> list[tuple[str, dict[str, Any]]]:
    if path.suffix.lower() == ".json":
        found = storage.read_json(path)
        if not isinstance(found, list) or not all(isinstance(row, dict) for row in found):
            raise InputError(path, "JSON", "is no list of objects", _MEND)
        return [(f"{path}: entry {place}", row) for place, row in enumerate(found, 1)]
    text = storage.read_text(path, MOST_BYTES).removeprefix("\ufeff")
    first = text.partition("\n")[0]
    reader = csv.DictReader(io.StringIO(text, newline=""), delimiter=";" if ";" in first else ",")
    try:
        if problem := _heading_fault(reader.fieldnames or ()):
            raise InputError(path, "heading", problem, _MEND)
        return [(f"{path}: line {reader.line_num}", _cells(row)) for row in reader]
    except csv.Error as error:  # such as a cell of more than 131,072 characters
        raise InputError(path, f"line {reader.line_num + 1}", str(error), _MEND) from None


def _heading_fault(names: Sequence[str]) -> str | None:
    if unknown := set(names) - VehicleRow.model_fields.keys():
        return f"{min(unknown)!r} is no column"
    if not {"id", "kind"} <= set(names):
        return "id and kind are needed"
    return "names a column twice" if len(set(names)) < len(names) else None


def _cells(row: dict[str | None, Any]) -> dict[str, Any]:
    cells = {name: value for name, value in row.items() if name is not None}
    filled = {name: value.strip() for name, value in cells.items() if value and value.strip()}
    if None in row:
        filled["more cells than columns"] = str(row[None])
    if "azimuths_deg" in filled:
        filled["azimuths_deg"] = filled["azimuths_deg"].split()
    return filled
