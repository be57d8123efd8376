"""Parametric vehicles and other shapes, and the reader of a user's own mesh."""

from recast.synthetic.vehicles.build import build_vehicle, sample_vehicle, vehicle_parts
from recast.synthetic.vehicles.colours import COLOURS, colour_shares, sample_colour
from recast.synthetic.vehicles.kinds import KIND_SHARES, sample_kind, sample_parameters
from recast.synthetic.vehicles.parameters import KINDS, VehicleParameters
from recast.synthetic.vehicles.read_mesh import read_mesh
from recast.synthetic.vehicles.shapes import SHAPES, sample_shape

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
