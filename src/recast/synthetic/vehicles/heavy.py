"""Box trucks and buses."""

from __future__ import annotations

from recast.synthetic.vehicles.cars import car
from recast.synthetic.vehicles.details import Parts
from recast.synthetic.vehicles.parameters import VehicleParameters
from recast.synthetic.vehicles.solid import Finish


def box_truck(p: VehicleParameters, paint: Finish) -> Parts:
    return car(p, paint)


def bus(p: VehicleParameters, paint: Finish) -> Parts:
    return car(p, paint)
