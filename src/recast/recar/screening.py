"""Screening by a person: a table and numbered contact sheets, of a vehicle set or of targets.

    FOLDER/screening.csv            one row a vehicle; `keep` is for the person: yes, no or empty
    FOLDER/screening-0001.png, ...  the vehicles under the numbers of the rows

Training leaves out the vehicles whose `keep` is no.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from recast.arrays import Image
from recast.core import files
from recast.core.diagnostics import Progress, tell
from recast.core.errors import InputError, printable
from recast.core.files import disk_errors
from recast.core.images import draw_text
from recast.logs.images import encode
from recast.recar.ingest import read_doubts
from recast.recar.ingest_table import OVERFLOW, csv_rows
from recast.recar.vehicle_set import VehicleSet
from recast.recar.views import over_panel, shrunk

Decision = Literal["yes", "no"]
SCREENING_FILE = "screening.csv"
PASSED = "ok"
"""Verdict of a vehicle that no automatic check doubts."""

_MEND = "correct the row, or delete the file and screen again"
_PERSONS = ("keep", "note")
_SHEET = (1440, 1400)  # pixels that the cells of a sheet may fill
_CAPTION = 34
_VIEW = (176, 118)  # pixels at most of one view in the cell of a set's vehicle
_SHOWN = 4  # views of a set's vehicle
_INK, _RED = (31, 36, 48), (180, 30, 30)


@dataclass(frozen=True)
class ScreenedVehicle:
    """What a person sees of one vehicle.

    Attributes:
        figures: columns of the table; the same names for all vehicles.
        verdict: `PASSED`, or the reason why an automatic check doubts the vehicle.
        picture: (H, W, 3) uint8, of one size for all vehicles.
    """

    id: str
    figures: Mapping[str, object]
    verdict: str
    picture: Image


@dataclass(frozen=True)
class ScreeningSummary:
    """Numbers of sheets and vehicles, of those in doubt, decided, and left out."""

    sheets: int
    vehicles: int
    doubted: int
    decided: int
    left_out: int


def read_decisions(folder: Path, known: Collection[str]) -> dict[str, Decision]:
    """What a person decided about vehicles, by id; empty if there is no screening.csv.

    Args:
        known: ids of all its vehicles.

    Raises:
        InputError: a column is missing, a row is about an unknown vehicle or the second one about
            the same, or `keep` holds another word; the line names file, row and column.
    """
    return _decisions(_read(folder, known)[1])


def write_screening(
    folder: Path,
    known: Collection[str],
    vehicles: Iterable[ScreenedVehicle],
    progress: Progress | None = None,
) -> ScreeningSummary:
    """Write the table and the sheets; `keep` and all other columns of the person stay.

    Args:
        known: ids of `vehicles`.
        vehicles: vehicles in the order of the table; taken one by one.
        progress: called with vehicles done and all vehicles.

    Raises:
        InputError: as `read_decisions`, before anything is written; or the disk is full.
    """
    columns, before = _read(folder, known)
    decisions = _decisions(before)
    rows: list[dict[str, object]] = []
    cells: list[Image] = []
    sheets = doubted = 0
    for number, one in enumerate(vehicles, 1):
        row = {"number": number, "id": one.id, **one.figures, "verdict": one.verdict}
        theirs = [name for name in columns or _PERSONS if name not in row]
        rows.append(row | {name: before.get(one.id, {}).get(name, "") for name in theirs})
        cells.append(_cell(number, one, decisions.get(one.id)))
        doubted += one.verdict != PASSED
        across, down = (max(s // c, 1) for s, c in zip(_SHEET, cells[0].shape[1::-1], strict=True))
        if len(cells) == across * down or number == len(known):
            sheets += 1
            files.write_bytes(_sheet_path(folder, sheets), encode(_sheet(cells, across)))
            cells = []
        tell(progress, number, len(known))
    with disk_errors(folder):
        for path in folder.glob("screening-[0-9]*.png"):
            if path.name > _sheet_path(folder, sheets).name:
                path.unlink()
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    files.write_text(folder / SCREENING_FILE, text.getvalue())
    left_out = sum(decision == "no" for decision in decisions.values())
    return ScreeningSummary(sheets, len(rows), doubted, len(decisions), left_out)


def screened_vehicles(vehicle_set: VehicleSet) -> Iterator[ScreenedVehicle]:
    """The vehicles of a set, each by up to four views; verdicts are the doubts of `ingest`.

    Raises:
        InputError: a picture or ingest.json is broken.
    """
    doubts = read_doubts(vehicle_set.folder)
    views = vehicle_set.record.views
    shown = [i * views // min(_SHOWN, views) for i in range(min(_SHOWN, views))]
    for name, identity in vehicle_set.identities.items():
        one = identity.record
        pictures = [identity.view(index) for index in shown]
        covered = np.mean([np.mean(picture[..., 3] > 127) for picture in pictures])
        length, width, height = one.size or (None, None, None)
        yield ScreenedVehicle(
            name,
            {
                "kind": one.kind,
                "colour": one.colour,
                "split": one.split,
                "length_m": length,
                "width_m": width,
                "height_m": height,
                "distance_m": one.distance_m,
                "covered_percent": f"{100 * covered:.1f}",
            },
            "not checked" if doubts is None else "; ".join(doubts.get(name, ())) or PASSED,
            np.hstack([over_panel(shrunk(picture, *_VIEW)) for picture in pictures]),
        )


def _read(
    folder: Path, known: Collection[str]
) -> tuple[tuple[str, ...], dict[str, dict[str, str]]]:
    """Names of the columns, and the cells of each vehicle by its id."""
    path = folder / SCREENING_FILE
    if not path.exists():
        return (), {}
    columns, rows = csv_rows(path, _MEND)
    for name in ("id", "keep"):
        if name not in columns:
            mend = f"name a column {name}, or delete the file and screen again"
            raise InputError(f"{path}: line 1", name, "is not a column", mend)
    found: dict[str, dict[str, str]] = {}
    for where, cells in rows:
        name, keep = cells.get("id", ""), cells.get("keep", "").lower()
        if OVERFLOW in cells:
            raise InputError(where, OVERFLOW, "are there", "put text with commas in quotes")
        if name not in known:
            mend = "remove the row, or restore the vehicle"
            raise InputError(where, "id", f"{name[:100]!r} is not in {folder.name}", mend)
        if name in found:
            raise InputError(where, "id", f"{name} has two rows", "keep one of them")
        if keep not in ("", "yes", "no"):
            mend = "write yes, no or nothing; other words belong in the column note"
            raise InputError(where, "keep", f"is {cells['keep'][:100]!r}", mend)
        found[name] = cells | {"keep": keep}
    return columns, found


def _decisions(rows: Mapping[str, Mapping[str, str]]) -> dict[str, Decision]:
    decided: dict[str, Decision] = {}
    for name, cells in rows.items():
        if cells["keep"]:
            decided[name] = "no" if cells["keep"] == "no" else "yes"
    return decided


def _sheet_path(folder: Path, number: int) -> Path:
    return folder / f"screening-{number:04d}.png"


def _cell(number: int, one: ScreenedVehicle, decision: Decision | None) -> Image:
    """A vehicle's picture under its number, labels and verdict, with a white edge."""
    height, width = one.picture.shape[:2]
    cell = np.full((height + _CAPTION + 8, width + 8, 3), 255, np.uint8)
    labels = [
        str(number),
        one.id,
        *(str(one.figures.get(name) or "") for name in ("kind", "colour")),
    ]
    kept = "" if decision is None else f"   keep: {decision}"
    letters = width // 7
    draw_text(cell, (4, 14), printable("  ".join(labels) + kept)[:letters], _INK, 12, "ls")
    if one.verdict != PASSED:
        draw_text(cell, (4, 30), printable(one.verdict)[:letters], _RED, 11, "ls")
    shown = one.picture if decision != "no" else one.picture // 3 + 170  # faded
    cell[_CAPTION : _CAPTION + height, 4 : 4 + width] = shown
    return cell


def _sheet(cells: list[Image], across: int) -> Image:
    blank = np.full_like(cells[0], 255)
    cells = cells + [blank] * (-len(cells) % min(across, len(cells)))
    across = min(across, len(cells))
    return np.vstack(
        [np.hstack(cells[place : place + across]) for place in range(0, len(cells), across)]
    )
