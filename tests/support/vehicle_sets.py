"""Small vehicle sets made of coloured rectangles."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recast.arrays import Image
from recast.recar import (
    IdentityRecord,
    SetRecord,
    VehicleSet,
    begin_set,
    finish_set,
    read_set,
    regular_azimuths,
    split_of,
    write_identity,
)

WIDTH, HEIGHT, VIEWS = 48, 32, 4
KINDS = ("sedan", "van", "sedan")
COLOURS = ("white", "red", "white")


def set_record(identities: int = 3, **changes: object) -> SetRecord:
    """The record of a set of photographs."""
    fields: dict[str, object] = {
        "complete": True,
        "name": "rectangles",
        "licence": "CC-BY-4.0",
        "source": "drawn by the tests",
        "identities": identities,
        "azimuths_deg": regular_azimuths(VIEWS),
        "elevation_deg": 15.0,
        "fov_deg": 40.0,
        "width": WIDTH,
        "height": HEIGHT,
        "split_seed": 0,
        "held_out_share": 0.05,
        "generator": None,
    }
    return SetRecord.model_validate(fields | changes)


def identity_record(index: int, **changes: object) -> IdentityRecord:
    name = f"car-{index}"
    fields: dict[str, object] = {
        "id": name,
        "kind": KINDS[index % 3],
        "category": "car",
        "colour": COLOURS[index % 3],
        "size": (4.5 + 0.1 * index, 1.8, 1.5),
        "distance_m": 8.0,
        "split": split_of(name, 0, index=index),
    }
    return IdentityRecord.model_validate(fields | changes)


def pictures(index: int, views: int = VIEWS) -> list[Image]:
    """A rectangle of another shade in every view, with one half-transparent column."""
    images = []
    for view in range(views):
        image = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
        image[8:24, 8:40] = (200, 40 * view, 10 * index, 255)
        image[8:24, 40, :] = (200, 40 * view, 10 * index, 128)
        images.append(image)
    return images


def write_set(folder: Path, identities: int = 3) -> VehicleSet:
    """A complete set."""
    record = set_record(identities)
    begin_set(folder, record, [f"car-{index}" for index in range(identities)])
    for index in range(identities):
        write_identity(folder, record, identity_record(index), pictures(index))
    finish_set(folder, record)
    return read_set(folder)


def tree(folder: Path) -> dict[str, bytes]:
    """All files below a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
