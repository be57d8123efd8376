"""A small vehicle set that is photographed from all around, and generators that know it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from recast.actors import Asset, Observation, TemplateGenerator
from recast.actors.generate import UNIT_CUBE_Z_UP
from recast.core.errors import InputError
from recast.recar import begin_set, finish_set, regular_azimuths, write_identity
from recast.recar.views import fitting_distance, pinhole
from recast.splats import Gaussians
from support.crops import SIZE, photograph, two_coloured_box
from support.vehicle_sets import identity_record, set_record

VIEWS, WIDTH, HEIGHT = 6, 72, 54
TARGETS = 4


def write_vehicle_set(folder: Path, held_out: int = 3) -> Path:
    """Vehicles that differ in brightness; `held_out` of them held out, one to train on."""
    record = set_record(
        held_out + 1, azimuths_deg=regular_azimuths(VIEWS), width=WIDTH, height=HEIGHT
    )
    camera = pinhole(WIDTH, HEIGHT, 40.0)
    distance = fitting_distance(SIZE, camera)
    begin_set(folder, record, [f"car-{index}" for index in range(held_out + 1)])
    for index in range(held_out + 1):
        one = identity_record(
            index, split="train" if index == 0 else "held-out", size=SIZE, distance_m=distance
        )
        pictures = [
            photograph(vehicle(index), azimuth, 15.0, camera, distance)
            for azimuth in record.azimuths_deg
        ]
        for picture in pictures:
            picture[picture[..., 3] == 0] = 0
        write_identity(folder, record, one, pictures)
    finish_set(folder, record)
    return folder


def vehicle(index: int) -> Gaussians:
    """Of the set, in the actor frame."""
    box = two_coloured_box()
    return replace(box, sh=box.sh + 0.15 * (index - 1))


class Knowing:
    """Gives the vehicle that was photographed, in a unit cube, or one that is off by a share."""

    name = "knowing"

    def __init__(self, off: float = 0.0, fails_on: str | None = None) -> None:
        self.off, self.fails_on = off, fails_on

    def generate(self, observation: Observation, seed: int) -> Asset:
        """The vehicle whose index stands in the observation's name."""
        name = observation.track_id.split("/")[0]
        if name == self.fails_on:
            raise InputError(name, "structure", "is empty", "try another seed")
        index = int(name.removeprefix("car-"))
        made = vehicle(index).transformed(torch.eye(4), 1 / SIZE[0])
        # what a network does: the worse the picture, the worse the vehicle
        seen = observation.rgba[..., 3] > 127
        off = self.off * (1 + float(np.std(observation.rgba[seen])) / 255)
        stretch = torch.tensor([1.0, 1.0, 1.0 - 0.5 * self.off])
        return Asset(
            replace(made, means=made.means * stretch, sh=made.sh + off),
            UNIT_CUBE_Z_UP,
            self.name,
            seed,
            {"off": self.off},
        )


def perfect() -> Knowing:
    return Knowing()


def near() -> Knowing:
    return Knowing(0.2)


def far() -> Knowing:
    return Knowing(0.8)


def failing() -> Knowing:
    return Knowing(0.2, fails_on="car-2")


def hopeless() -> Knowing:
    return Knowing(0.2, fails_on="car-1")


def coarse_template() -> TemplateGenerator:
    return TemplateGenerator(spacing=0.14, style="hatchback")
