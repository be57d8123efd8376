"""From parameters to a finished vehicle."""

from __future__ import annotations

import numpy as np

from recast.synthetic.surface import Surface, concatenate
from recast.synthetic.vehicles.box_truck import box_truck
from recast.synthetic.vehicles.bus import bus
from recast.synthetic.vehicles.cars import car
from recast.synthetic.vehicles.colours import paint_rgb, sample_colour
from recast.synthetic.vehicles.details import Parts
from recast.synthetic.vehicles.kinds import CATEGORIES, sample_kind, sample_parameters
from recast.synthetic.vehicles.parameters import VehicleParameters
from recast.synthetic.vehicles.solid import Finish
from recast.synthetic.world import VehicleModel


def vehicle_parts(parameters: VehicleParameters, colour: str) -> Parts:
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
    return [(name, _fitted(part, middle, scale)) for name, part in parts]


def build_vehicle(parameters: VehicleParameters, colour: str) -> VehicleModel:
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


def _fitted(part: Surface, middle: np.ndarray, scale: np.ndarray) -> Surface:
    normals = part.normals / scale
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return Surface(
        (part.vertices - middle) * scale,
        part.faces,
        normals.astype(np.float32),
        part.colours,
        part.materials,
    )
