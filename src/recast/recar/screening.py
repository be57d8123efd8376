"""A vehicle set looked at by a person: numbered contact sheets with a table, and its figures.

    FOLDER/screening.csv            one row a vehicle; `keep` is for the person: yes, no or empty
    FOLDER/screening-0001.png, ...  the vehicles under the numbers of the rows

Caches of targets are screened too. Training leaves out the vehicles whose `keep` is no.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from PIL import ImageColor
from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table
from rich.text import Text

from recast.arrays import Image
from recast.core import files
from recast.core.diagnostics import Progress, tell
from recast.core.errors import InputError, printable
from recast.core.files import disk_errors
from recast.core.images import draw_text
from recast.geometry.colour import linear_to_srgb
from recast.logs.images import encode
from recast.recar.ingest import read_doubts
from recast.recar.ingest_table import OVERFLOW, csv_rows
from recast.recar.vehicle_set import SPLITS, Identity, VehicleSet
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


_MUTED, _EDGE = (107, 114, 128), (154, 161, 173)
_CELL = (220, 147)  # pixels at most of a view in the overview, before it is cut
_HEAD, _LABEL, _LINE, _BARS, _LONGEST = 64, 110, 22, 440, 230
_MOST_BARS = 12


@dataclass(frozen=True)
class SetStatistics:
    """Counts over a set.

    Attributes:
        kinds, colours: numbers of identities by kind and by colour, the most frequent first.
        sizes: least, median and greatest length, width, height in metres (3, 3), or None where no
            identity has a size.
        decided, left_out: numbers of identities that a person decided about, and left out of
            training, see `recast.recar.screening`.
    """

    identities: int
    pictures: int
    bytes: int
    splits: dict[str, int]
    kinds: dict[str, int]
    colours: dict[str, int]
    sizes: tuple[tuple[float, float, float], ...] | None
    decided: int
    left_out: int


def set_statistics(vehicle_set: VehicleSet) -> SetStatistics:
    """Count what is in a set.

    Raises:
        InputError: a picture is missing, or screening.csv is wrong.
    """
    decisions = read_decisions(vehicle_set.folder, vehicle_set.identities)
    splits, kinds, colours = Counter[str](), Counter[str](), Counter[str]()
    identities, total_bytes = len(vehicle_set.identities), 0
    metres: list[float] = []
    for identity in vehicle_set.identities.values():
        record = identity.record
        total_bytes += identity.picture_bytes()
        splits[record.split] += 1
        kinds[record.kind] += 1
        colours[record.colour or "unknown"] += 1
        metres.extend(record.size or ())
    sizes = np.array(metres).reshape(-1, 3)
    return SetStatistics(
        identities=identities,
        pictures=identities * vehicle_set.record.views,
        bytes=total_bytes,
        splits={split: splits[split] for split in SPLITS},
        kinds=_by_count(kinds),
        colours=_by_count(colours),
        sizes=tuple(
            (float(row[0]), float(row[1]), float(row[2]))
            for row in (sizes.min(axis=0), np.median(sizes, axis=0), sizes.max(axis=0))
        )
        if len(sizes)
        else None,
        decided=len(decisions),
        left_out=sum(decision == "no" for decision in decisions.values()),
    )


def statistics_table(vehicle_set: VehicleSet, statistics: SetStatistics) -> Group:
    """The figures for a terminal: the set, and its kinds and colours with their shares."""
    record, total = vehicle_set.record, statistics.identities
    held_out = statistics.splits["held-out"]
    rows = [
        ("source", record.source),
        ("licence", record.licence),
        ("identities", f"{total:,}"),
        ("split", f"{statistics.splits['train']:,} train, {held_out:,} held out"),
        (
            "views",
            f"{record.views} per identity, {record.width}x{record.height}, "
            f"{statistics.pictures:,} images, {statistics.bytes / 1e6:,.1f} MB",
        ),
        ("camera", f"elevation {_degrees(record.elevation_deg)}, fov {_degrees(record.fov_deg)}"),
    ]
    if statistics.decided:
        said = f"{statistics.decided:,} decided, {statistics.left_out:,} left out of training"
        rows.append(("screening", said))
    if statistics.sizes is not None:
        least, median, most = statistics.sizes
        rows += [
            (name, f"{median[i]:.2f} m median, {least[i]:.2f} to {most[i]:.2f}")
            for i, name in enumerate(("length", "width", "height"))
        ]
    return Group(
        summary_table(record.name, rows),
        _count_table("kind", statistics.kinds, total),
        _count_table("colour", statistics.colours, total),
    )


def summary_table(title: str, rows: Iterable[tuple[str, str]]) -> Table:
    """Names and what they say, for a terminal."""
    shown = Text(printable(title))
    table = Table(title=shown, title_justify="left", box=SIMPLE_HEAD, show_header=False)
    for name, text in rows:
        table.add_row(name, Text(printable(text)))
    return table


def _by_count(counts: Counter[str]) -> dict[str, int]:
    return {name: counts[name] for name in sorted(counts, key=lambda name: (-counts[name], name))}


def _count_table(heading: str, counts: dict[str, int], total: int) -> Table:
    table = Table(box=SIMPLE_HEAD)
    table.add_column(heading, min_width=14)
    table.add_column("identities", justify="right")
    table.add_column("share", justify="right")
    for name, count in counts.items():
        table.add_row(Text(printable(name)), f"{count:,}", f"{100 * count / total:.1f} %")
    return table


def _degrees(value: float | None) -> str:
    return "not measured" if value is None else f"{value:g} degrees"


def write_overview(vehicle_set: VehicleSet, statistics: SetStatistics, path: Path) -> None:
    """Draw a PNG: representative vehicles from all sides, and shares of the colours and kinds.

    Raises:
        InputError: a picture is broken, or the disk is full.
    """
    record, rows = vehicle_set.record, representatives(vehicle_set, 8)
    views = _columns(record.views, 6)
    sheet = view_sheet(rows, views)
    height, width = sheet.shape[:2]
    shares = {"Colours": _most(statistics.colours), "Kinds": _most(statistics.kinds)}
    bars = _HEAD + 60 + sum(_LINE * (len(counts) + 1) for counts in shares.values())
    canvas = np.full((max(_HEAD + height + 12, bars), _LABEL + width + _BARS, 3), 255, np.uint8)
    canvas[_HEAD : _HEAD + height, _LABEL : _LABEL + width] = sheet
    title = (
        f"{record.name}: {statistics.identities:,} identities, {record.views} views each, "
        f"{statistics.pictures:,} RGBA images of {record.width}x{record.height}"
    )
    draw_text(canvas, (12, 24), printable(title), _INK, 18, "ls")
    for place, view in enumerate(views):
        x = _LABEL + (2 * place + 1) * width // (2 * len(views)) - 14
        draw_text(canvas, (x, _HEAD - 8), f"{record.azimuths_deg[view]:g} deg", _MUTED, 12, "ls")
    for row, identity in enumerate(rows):
        y = _HEAD + (2 * row + 1) * height // (2 * len(rows))
        draw_text(canvas, (8, y), printable(identity.record.kind)[:16], _INK, 12, "ls")
        draw_text(
            canvas, (8, y + 16), printable(identity.record.colour or "")[:16], _MUTED, 12, "ls"
        )
    left, top = _LABEL + width + 24, _HEAD
    for heading, counts in shares.items():
        draw_text(canvas, (left, top), f"{heading}, % of identities", _INK, 15, "ls")
        _draw_bars(canvas, counts, left, top + _LINE, swatch if heading == "Colours" else _plain)
        top += _LINE * (len(counts) + 1) + 40
    files.write_bytes(path, encode(canvas))


def representatives(vehicle_set: VehicleSet, count: int) -> list[Identity]:
    """Up to `count` identities: all kinds in turn, the most frequent first, colours varied."""
    by_kind: dict[str, list[Identity]] = {}
    for identity in vehicle_set.identities.values():
        by_kind.setdefault(identity.record.kind, []).append(identity)
    queues = sorted(by_kind.values(), key=len, reverse=True)
    chosen: list[Identity] = []
    shown = Counter[str | None]()
    while len(chosen) < min(count, len(vehicle_set.identities)):
        for queue in queues:
            if queue and len(chosen) < count:
                rarest = min(queue, key=lambda one: shown[one.record.colour])
                queue.remove(rarest)
                shown[rarest.record.colour] += 1
                chosen.append(rarest)
    return chosen


def view_sheet(identities: list[Identity], views: list[int]) -> Image:
    """A sheet (rows, columns, 3) uint8: a row for each identity, a column for each view.

    All cells are cut alike, to what is not empty in every one of them.
    """
    cells = [[shrunk(one.view(view), *_CELL) for view in views] for one in identities]
    rows, columns = np.nonzero(np.max([cell[..., 3] for row in cells for cell in row], axis=0))
    height, width = cells[0][0].shape[:2]
    edge = round(0.03 * width)
    top, bottom = max(rows.min() - edge, 0), min(rows.max() + 1 + edge, height)
    left, right = max(columns.min() - edge, 0), min(columns.max() + 1 + edge, width)
    cut = [[over_panel(cell[top:bottom, left:right]) for cell in row] for row in cells]
    return np.vstack([np.hstack(row) for row in cut])


def _columns(views: int, count: int) -> list[int]:
    """About `count` views, evenly apart where the number of views has a fitting divisor."""
    even = [n for n in range(count - 2, count + 3) if n > 0 and views % n == 0]
    columns = min(even, key=lambda n: (abs(n - count), -n)) if even else min(count, views)
    return [i * views // columns for i in range(columns)]


def _most(counts: dict[str, int]) -> dict[str, int]:
    """The most frequent names, and all others as one."""
    shown = dict(list(counts.items())[:_MOST_BARS])
    rest = sum(counts.values()) - sum(shown.values())
    return shown | {"others": shown.get("others", 0) + rest} if rest else shown


def _draw_bars(
    canvas: Image,
    counts: dict[str, int],
    left: int,
    top: int,
    colour_of: Callable[[str], tuple[int, int, int] | None],
) -> None:
    """A line for each name: the name, a bar as long as its share, and the share in percent."""
    total, most = sum(counts.values()), max(counts.values())
    for line, (name, count) in enumerate(counts.items()):
        y = top + line * _LINE
        draw_text(canvas, (left, y + 12), printable(name)[:16], _INK, 12, "ls")
        start, end = left + _LABEL, left + _LABEL + max(round(_LONGEST * count / most), 2)
        colour = colour_of(name)
        cv2.rectangle(canvas, (start, y), (end, y + 14), colour or (255, 255, 255), -1)
        cv2.rectangle(canvas, (start, y), (end, y + 14), _EDGE, 1)
        if colour is None:  # unknown colours are crossed out
            cv2.line(canvas, (start, y + 14), (end, y), _EDGE, 1)
        share = 100 * count / total
        words = f"{share:.0f}" if share >= 1 else f"{share:.1f}"
        draw_text(canvas, (end + 6, y + 12), words, _INK, 12, "ls")


def _plain(name: str) -> tuple[int, int, int]:
    return 59, 110, 168


def swatch(name: str) -> tuple[int, int, int] | None:
    """sRGB in [0, 255] of a colour's name, or None for a name that nobody knows."""
    from recast.synthetic.vehicles import COLOURS  # readers of sets need no ray tracer

    if name in COLOURS:
        levels = 255 * linear_to_srgb(np.asarray(COLOURS[name].rgb, np.float64))
        red, green, blue = np.rint(levels).astype(int).tolist()
        return red, green, blue
    try:
        return ImageColor.getrgb(name)[:3]
    except ValueError:
        return None
