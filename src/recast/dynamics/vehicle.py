"""The ego vehicle's dimensions."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class VehicleParameters:
    """Outline and wheelbase of a vehicle, measured from its rear axle, in metres.

    The defaults are nuPlan's Chrysler Pacifica, the vehicle the published planners drive.

    Attributes:
        width: over the body.
        front_length: rear axle to front bumper.
        rear_length: rear axle to rear bumper.
        wheelbase: rear axle to front axle.
    """

    width: float = 2.297
    front_length: float = 4.049
    rear_length: float = 1.127
    wheelbase: float = 3.089

    def __post_init__(self) -> None:
        for name in ("width", "front_length", "rear_length", "wheelbase"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"VehicleParameters.{name}: must be positive metres")

    @property
    def length(self) -> float:
        """Bumper to bumper, metres."""
        return self.front_length + self.rear_length

    @property
    def centre_offset(self) -> float:
        """Distance from the rear axle forward to the centre of the box, metres."""
        return (self.front_length - self.rear_length) / 2


PACIFICA = VehicleParameters()
