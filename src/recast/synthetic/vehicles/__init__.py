"""Parametric vehicles and other shapes, and the reader of a user's own mesh."""

from __future__ import annotations

import numpy as np

from recast.synthetic.surface import at, concatenate
from recast.synthetic.vehicles.bodywork import Parts
from recast.synthetic.vehicles.kinds import box_truck, bus, car
from recast.synthetic.vehicles.parameters import (
    COLOURS,
    KIND_SHARES,
    KINDS,
    VehicleSizes,
    colour_shares,
    paint_rgb,
    sample_colour,
    sample_kind,
    sample_parameters,
)
from recast.synthetic.vehicles.shapes import SHAPES, read_mesh, sample_shape
from recast.synthetic.vehicles.solid import Finish
from recast.synthetic.world import VehicleModel

__all__ = [
    "COLOURS",
    "KINDS",
    "KIND_SHARES",
    "SHAPES",
    "VehicleSizes",
    "build_vehicle",
    "colour_shares",
    "read_mesh",
    "sample_colour",
    "sample_kind",
    "sample_parameters",
    "sample_shape",
    "sample_vehicle",
    "vehicle_parts",
]

CATEGORIES: dict[str, str] = {"van": "van", "pickup": "car", "box-truck": "truck", "bus": "bus"}
"""Kind -> category of the label; all others are "car"."""


def vehicle_parts(parameters: VehicleSizes, colour: str) -> Parts:
    """Name and surface of every part, each closed, in the actor-local frame.

    Raises:
        InputError: an impossible size, or an unknown colour.
    """
    parameters.validate()
    paint = Finish(paint_rgb(colour, parameters.shade), "paint")
    maker = {"bus": bus, "box-truck": box_truck}.get(parameters.kind, car)
    parts = maker(parameters, paint)
    counted = [part.bounds() for name, part in parts if not name.startswith("mirror")]
    low = np.min([bounds[0] for bounds in counted], axis=0)
    high = np.max([bounds[1] for bounds in counted], axis=0)
    size = np.array([parameters.length, parameters.width, parameters.height])
    # Handles, rails and bowed skins differ from the stated size by millimetres; the box is exact.
    scale, middle = size / (high - low), (low + high) / 2
    return [(name, at(part, *-middle).scaled(scale)) for name, part in parts]


def build_vehicle(parameters: VehicleSizes, colour: str) -> VehicleModel:
    """The finished vehicle; its size is the bounds of all parts but the mirrors.

    Args:
        parameters: sizes.
        colour: a name in `COLOURS`.

    Raises:
        InputError: an impossible size, or an unknown colour.
    """
    parts = vehicle_parts(parameters, colour)
    return VehicleModel(
        kind=parameters.kind,
        category=CATEGORIES.get(parameters.kind, "car"),
        colour=colour,
        size=np.array([parameters.length, parameters.width, parameters.height]),
        surface=concatenate([part for _, part in parts]),
    )


def sample_vehicle(rng: np.random.Generator, kind: str | None = None) -> VehicleModel:
    """A random vehicle: kind (unless given), sizes and colour as on the road.

    Raises:
        InputError: no such kind.
    """
    kind = sample_kind(rng) if kind is None else kind
    parameters = sample_parameters(kind, rng)
    return build_vehicle(parameters, sample_colour(kind, rng))
