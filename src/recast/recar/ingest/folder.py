"""The folder of one vehicle: which photograph is which view."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from recast.errors import InputError
from recast.names import member
from recast.recar.ingest.photograph import SUFFIXES, natural_order, photograph_size
from recast.recar.ingest.settings import IngestSettings
from recast.recar.ingest.table import VehicleRow
from recast.storage import disk_errors

AZIMUTH_WITHIN = 0.1
"""Share of the step between two views by which a measured azimuth may be off."""


def photographs_of(photos: Path, row: VehicleRow, settings: IngestSettings) -> tuple[Path, ...]:
    """The photographs of a vehicle by rising azimuth, its front first; headers are read.

    Raises:
        InputError: the folder is missing, photographs are missing, too many or of several sizes,
            or their azimuths are not regular.
    """
    folder = member(photos, row.folder or row.id, row.id, "folder")
    with disk_errors(folder):
        if not folder.is_dir():
            mend = f"add it, or take {row.id} off the table"
            raise InputError(folder, "folder", "is missing", mend)
        files = [path for path in folder.iterdir() if path.is_file() and path.name[0] != "."]
    found = sorted((f for f in files if f.suffix.lower() in SUFFIXES), key=natural_order)
    if len(found) != settings.views:
        others = len(files) - len(found)
        looked = f" ({others} other files were not looked at)" if others else ""
        raise InputError(
            folder, "photographs", f"are {len(found)} where the set has {settings.views} views"
            f"{looked}", "add the missing azimuths, or give --views",
        )  # fmt: skip
    ordered = (
        _by_azimuth(folder, found, row) if row.azimuths_deg else _by_order(found, row, settings)
    )
    check_sizes(ordered, settings)
    return tuple(ordered)


def _by_order(found: list[Path], row: VehicleRow, settings: IngestSettings) -> list[Path]:
    if row.front > len(found):
        raise InputError(row.id, "front", f"is {row.front} of {len(found)}", "count from 1")
    turned = found[row.front - 1 :] + found[: row.front - 1]
    return [turned[0], *reversed(turned[1:])] if settings.clockwise else turned


def _by_azimuth(folder: Path, found: list[Path], row: VehicleRow) -> list[Path]:
    azimuths: Sequence[float] = row.azimuths_deg or ()
    if len(azimuths) != len(found):
        raise InputError(
            folder, "azimuths_deg", f"are {len(azimuths)} for {len(found)} photographs",
            "give one for each",
        )  # fmt: skip
    step = 360 / len(found)
    places: dict[int, Path] = {}
    for path, azimuth in zip(found, azimuths, strict=True):
        place = round(azimuth / step) % len(found)
        off = (azimuth - place * step + 180) % 360 - 180
        if abs(off) > AZIMUTH_WITHIN * step or place in places:
            raise InputError(
                path, "azimuth", f"{azimuth:g} is not regular: one in each {step:g} degrees from 0 "
                "is expected", "take the photographs at regular azimuths",
            )  # fmt: skip
        places[place] = path
    return [places[place] for place in range(len(found))]


def check_sizes(paths: Sequence[Path], settings: IngestSettings) -> None:
    """Look at the headers of the photographs of a vehicle.

    Raises:
        InputError: they have several sizes, or not the shape that an angle of view needs.
    """
    width, height = photograph_size(paths[0])
    for path in paths:
        size = photograph_size(path)
        if size != (width, height):
            raise InputError(
                path, "size", f"is {size[0]}x{size[1]} where {paths[0].name} has {width}x{height}",
                "give all photographs of a vehicle one size",
            )  # fmt: skip
    scale = min(settings.width / width, settings.height / height)
    if settings.fov_deg is not None and round(width * scale) != settings.width:
        raise InputError(
            paths[0], "size", f"is {width}x{height}: --fov needs the shape of "
            f"{settings.width}x{settings.height}", "give --width and --height of that shape",
        )  # fmt: skip
