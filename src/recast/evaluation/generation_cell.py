"""What a generation study keeps of one vehicle: by one model from one picture, or of the truth.

FOLDER/cell.json      scores of every view, or why there is none
FOLDER/features.npz   (V, D) float32 by name of the features
FOLDER/strip.png      the views side by side
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage

from recast.errors import InputError
from recast.evaluation.rounding import rounded
from recast.storage import atomic_folder, read_json, write_json

Features = NDArray[np.float32]
Image = NDArray[np.uint8]

_CELL, _FEATURES, _STRIP = "cell.json", "features.npz", "strip.png"


@dataclass(frozen=True)
class Cell:
    """One vehicle.

    Attributes:
        key: hash of all that decides the contents; another one makes the cell stale.
        id: of the vehicle.
        facts: about how it was made and placed, plain values.
        views: names of the views it was looked at in.
        scores: of each view, by key of `STUDY_COLUMNS`; none for the truth.
        features: (V, D) by name of the features.
        failure: why it could not be made; then there are no views.
    """

    key: str
    id: str
    facts: Mapping[str, Any]
    views: tuple[str, ...] = ()
    scores: tuple[Mapping[str, float], ...] = ()
    features: Mapping[str, Features] = field(default_factory=dict)
    failure: str | None = None


def write_cell(folder: Path, cell: Cell, pictures: Mapping[str, Image]) -> None:
    """Write a cell in place of what was there, whole or not at all.

    Args:
        folder: of the cell.
        cell: what is written.
        pictures: images (H, W, 3) uint8 by name of the file, without ending.

    Raises:
        InputError: the disk is full.
    """
    if folder.exists():
        shutil.rmtree(folder)
    with atomic_folder(folder) as partial:
        record = {
            "key": cell.key, "id": cell.id, "failure": cell.failure, "facts": dict(cell.facts),
            "views": list(cell.views), "scores": [dict(one) for one in cell.scores],
        }  # fmt: skip
        for name, picture in pictures.items():
            PilImage.fromarray(picture).save(partial / f"{name}.png", format="PNG")
        with (partial / _FEATURES).open("wb") as stream:
            arrays: dict[str, Any] = dict(cell.features)
            np.savez(stream, **arrays)
        write_json(partial / _CELL, rounded(record))


def cell_is(folder: Path, key: str) -> bool:
    """Whether there is a cell of that key."""
    if not (folder / _CELL).is_file():
        return False
    record = read_json(folder / _CELL)
    return isinstance(record, dict) and record.get("key") == key


def read_cell(folder: Path) -> Cell:
    """Read what `write_cell` wrote.

    Raises:
        InputError: it is missing or broken.
    """
    record = read_json(folder / _CELL)
    try:
        with np.load(folder / _FEATURES, allow_pickle=False) as file:
            features = {name: file[name] for name in file.files}
        return Cell(
            record["key"], record["id"], record["facts"], tuple(record["views"]),
            tuple(record["scores"]), features, record["failure"],
        )  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError, EOFError) as error:
        raise InputError(
            folder, "cell", f"cannot be read ({error})", "remove it and run again"
        ) from None


def read_strip(folder: Path, name: str = "strip") -> Image:
    """A picture (H, W, 3) of a cell.

    Raises:
        InputError: it is missing or broken.
    """
    path = folder / f"{name}.png"
    try:
        with PilImage.open(path) as picture:
            return np.asarray(picture.convert("RGB"), np.uint8)
    except OSError as error:
        raise InputError(
            path, "picture", f"cannot be read ({error})", "remove its folder and run again"
        ) from None
