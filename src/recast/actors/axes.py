"""Axis conventions of generated vehicles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AxisConvention:
    """How an asset's frame relates to the actor frame (x forward, y left, z up).

    Attributes:
        name: for messages.
        forward, up: signed axes of the asset, such as "+x" or "-z". The yaw search of the
            registration corrects a wrong `forward`, but not a wrong `up`.
        declares_front: whether `forward` is known to be the vehicle's, not only an axis of the
            file. Lengths are never relied upon: assets are scaled to the logged box.
    """

    name: str
    forward: str
    up: str
    declares_front: bool

    def rotation(self) -> Array:
        """(3, 3) actor axes from asset axes, a proper rotation.

        Raises:
            ValueError: an axis is not one of +x -x +y -y +z -z, or both are the same axis.
        """
        forward, up = _axis(self.forward), _axis(self.up)
        if abs(float(forward @ up)) > 0.5:
            raise ValueError(
                f"AxisConvention: forward {self.forward} and up {self.up} are parallel"
            )
        return np.stack([forward, np.cross(up, forward), up])


def _axis(name: str) -> Array:
    if len(name) != 2 or name[0] not in "+-" or name[1] not in "xyz":
        raise ValueError(f"AxisConvention: axis {name!r}, expected a sign and a letter such as +x")
    axis = np.zeros(3)
    axis["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return axis


VEHICLE = AxisConvention("vehicle", "+x", "+z", declares_front=True)
"""Metres, x forward, z up: what `template` makes."""
UNIT_CUBE_Z_UP = AxisConvention("unit_cube_z_up", "+x", "+z", declares_front=False)
"""A cube of edge one, z up, any heading: TRELLIS and its relatives."""
UNIT_CUBE_X_FORWARD = AxisConvention("unit_cube_x_forward", "+x", "+z", declares_front=True)
"""A cube of edge one, z up, facing +x: models that were trained on vehicles that all do."""
UNIT_CUBE_Y_UP = AxisConvention("unit_cube_y_up", "+z", "+y", declares_front=False)
"""A cube of edge one, y up, facing +z: glTF and most mesh tools."""
RECAR_BOX = AxisConvention("rear_right_up", "-x", "+z", declares_front=True)
"""Metres, x to the rear, y to the right: boxes of some vehicle datasets."""

CONVENTIONS = {
    c.name: c for c in (VEHICLE, UNIT_CUBE_Z_UP, UNIT_CUBE_X_FORWARD, UNIT_CUBE_Y_UP, RECAR_BOX)
}

UPS = {
    up: AxisConvention(
        up.replace("-", "minus-").removeprefix("+") + "-up", "+y" if "x" in up else "+x", up, False
    )
    for up in ("+x", "-x", "+y", "-y", "+z", "-z")
}
"""Conventions of any unit and heading, by the axis that points up."""

AUTO = "auto"
"""Name that stands for telling the axes from the shape, see `recast.actors.upright`."""
AXES_HELP = (
    "auto, z-up, y-up, minus-y-up or another UP, or FORWARD,UP such as x,z (--axes=-y,z with a "
    "minus), which says where the front is"
)


def axes_of(text: str) -> AxisConvention:
    """The convention of a name, of `UPS` or `CONVENTIONS`, or of two signed axes, such as "x,-y".

    Raises:
        InputError: there is none.
    """
    named = {one.name: one for one in UPS.values()} | CONVENTIONS
    if text in named:
        return named[text]
    axes = [axis if axis[:1] in "+-" else f"+{axis}" for axis in text.split(",")]
    try:
        forward, up = axes
        convention = AxisConvention(text, forward, up, declares_front=True)
        convention.rotation()
    except ValueError:
        raise InputError(
            "--axes", text, "is no axis convention",
            f"give {AXES_HELP}; or one of {', '.join(CONVENTIONS)}",
        ) from None  # fmt: skip
    return convention
