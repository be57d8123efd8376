"""Rows of Street Gaussians' track_info.txt: boxes in the vehicle's frame, one a line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.logs import checks
from recast.logs.types import Array
from recast.storage import read_text

CATEGORIES = {"vehicle": "car", "pedestrian": "pedestrian", "cyclist": "cyclist"}
"""Ours by the classes of the file that are reconstructed; it may hold others."""
_COLUMNS = (11, 12)  # frame track class alpha h w l cx cy cz heading [speed]


@dataclass(frozen=True)
class BoxRow:
    """One line.

    Attributes:
        where: the line, for messages.
        frame: number of the frame.
        track: as written.
        kind: class in lower case, whatever it is.
        size: (3,) length, width, height in metres, not checked.
        centre: (3,) metres, vehicle frame at the frame's time.
        heading: radians, counter-clockwise from the vehicle's x axis.
    """

    where: str
    frame: int
    track: str
    kind: str
    size: Array
    centre: Array
    heading: float


def read_box_rows(path: Path, mend: str) -> Iterator[BoxRow]:
    """All rows in the order of the file.

    Args:
        mend: what the user can do about any fault.

    Raises:
        InputError: the file is missing, or a line has too few or too many columns, or something
            else than numbers in range.
    """
    if not path.is_file():
        raise InputError(path, "file", "is missing", mend)
    lines = read_text(path).splitlines()
    for number, line in enumerate(lines[1:], start=2):  # the first names the columns
        words = line.split()
        if words:
            yield _row(path, f"line {number}", words, mend)


def _row(path: Path, where: str, words: list[str], mend: str) -> BoxRow:
    if len(words) not in _COLUMNS:
        raise InputError(path, where, f"has {len(words)} columns, not 11 or 12", mend)
    try:
        frame = int(words[0])
        height, width, length, x, y, z, heading = (float(word) for word in words[4:11])
    except ValueError:
        raise InputError(path, where, "holds words where numbers belong", mend) from None
    if not np.all(np.abs([height, width, length, x, y, z, heading]) <= checks.WORLD_REACH):
        problem = f"holds NaN or infinity, or a number not within {checks.WORLD_REACH:g}"
        raise InputError(path, where, problem, mend)
    size, centre = np.array([length, width, height]), np.array([x, y, z])
    return BoxRow(where, frame, words[1], words[2].lower(), size, centre, heading)
