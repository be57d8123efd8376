"""Parametric vehicles and other shapes, and the reader of a user's own mesh."""

from recast.synthetic.vehicles.build import (
    COLOURS,
    KIND_SHARES,
    build_vehicle,
    colour_shares,
    sample_colour,
    sample_kind,
    sample_parameters,
    sample_vehicle,
    vehicle_parts,
)
from recast.synthetic.vehicles.parameters import KINDS, VehicleParameters
from recast.synthetic.vehicles.shapes import SHAPES, read_mesh, sample_shape

__all__ = [
    "COLOURS",
    "KINDS",
    "KIND_SHARES",
    "SHAPES",
    "VehicleParameters",
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
