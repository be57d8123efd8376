"""Small vehicle sets with a rounded shape in every view, large enough to condition on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.recar import (
    IdentityRecord,
    SetRecord,
    VehicleSet,
    begin_set,
    finish_set,
    read_set,
    regular_azimuths,
    write_identity,
)

WIDTH, HEIGHT = 48, 32


def shape(index: int, view: int) -> NDArray[np.uint8]:
    """An ellipse, wider from the sides, with a darker half."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    wide = 18 if view % 2 else 11
    inside = ((x - 24) / wide) ** 2 + ((y - 17) / 9) ** 2 < 1
    image = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    image[inside] = [200 - 20 * (index % 8), 60 + 40 * view, 30 * (index % 8), 255]
    image[inside & (x > 30)] = [20, 20, 90, 255]
    return image


def write_vehicles(folder: Path, identities: int, views: int = 4) -> VehicleSet:
    """A set of cars called car-0, car-1, ...; the second one is held out."""
    record = SetRecord(
        complete=True,
        name="ellipses",
        licence="CC0-1.0",
        source="drawn by the tests",
        identities=identities,
        azimuths_deg=regular_azimuths(views),
        elevation_deg=15.0,
        fov_deg=40.0,
        width=WIDTH,
        height=HEIGHT,
        split_seed=0,
        held_out_share=0.05,
        generator=None,
    )
    names = [f"car-{index}" for index in range(identities)]
    begin_set(folder, record, names)
    for index, name in enumerate(names):
        one = IdentityRecord(
            id=name,
            kind="sedan",
            category="car",
            colour="red",
            size=(4.5, 1.8, 1.5),
            distance_m=8.0,
            split="held-out" if index == 1 else "train",
        )
        write_identity(folder, record, one, [shape(index, view) for view in range(views)])
    finish_set(folder, record)
    return read_set(folder)
