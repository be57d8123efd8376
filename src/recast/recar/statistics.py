"""What is in a vehicle set, in figures."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table
from rich.text import Text

from recast.core.errors import printable
from recast.recar.set_records import SPLITS
from recast.recar.views import VehicleSource


@dataclass(frozen=True)
class SetStatistics:
    """Counts over a set.

    Attributes:
        bytes: size of all picture files in bytes.
        splits: numbers of identities by split.
        kinds, colours: numbers of identities by kind and by colour, the most frequent first.
        sizes: least, median and greatest length, width, height in metres (3, 3), or None where no
            identity has a size.
    """

    identities: int
    pictures: int
    bytes: int
    splits: dict[str, int]
    kinds: dict[str, int]
    colours: dict[str, int]
    sizes: tuple[tuple[float, float, float], ...] | None


def set_statistics(vehicle_set: VehicleSource) -> SetStatistics:
    """Count what is in a set, in one pass that keeps three numbers of each identity."""
    splits, kinds, colours = Counter[str](), Counter[str](), Counter[str]()
    identities = total_bytes = 0
    metres = array("d")
    for record, picture_bytes in vehicle_set.records():
        identities += 1
        total_bytes += picture_bytes
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
    )


def statistics_table(vehicle_set: VehicleSource, statistics: SetStatistics) -> Group:
    """The figures for a terminal: the set, and its kinds and colours with their shares."""
    record, total = vehicle_set.record, statistics.identities
    title = Text(printable(record.name))
    summary = Table(title=title, title_justify="left", box=SIMPLE_HEAD, show_header=False)
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
    if statistics.sizes is not None:
        least, median, most = statistics.sizes
        rows += [
            (name, f"{median[i]:.2f} m median, {least[i]:.2f} to {most[i]:.2f}")
            for i, name in enumerate(("length", "width", "height"))
        ]
    for row in rows:
        summary.add_row(row[0], Text(printable(row[1])))
    return Group(
        summary,
        _count_table("kind", statistics.kinds, total),
        _count_table("colour", statistics.colours, total),
    )


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
