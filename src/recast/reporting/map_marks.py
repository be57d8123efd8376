"""What all bird's-eye pictures share: cars, the scale bar, a view that holds everything."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.geometry import boxes
from recast.reporting import palette
from recast.reporting.canvas import Canvas, View

Array = NDArray[np.float64]

_MARGIN = 6.0  # metres around everything
_MAX_SCALE = 14.0  # pixels a metre


def fitted_view(points: Array, heading: float, width: int, max_height: int) -> View:
    """The view that holds points (N, 2) with a margin, at 14 pixels a metre at most.

    Args:
        heading: world direction, radians, that points to the right.
        width: of the picture, pixels; it is at least a fifth as high, and `max_height` at most.
    """
    turned = View(np.zeros(2), heading, 1.0, 0, 0).pixels(points)
    low, high = turned.min(axis=0) - _MARGIN, turned.max(axis=0) + _MARGIN
    span = high - low
    scale = min(width / span[0], max_height / span[1], _MAX_SCALE)
    height = int(np.clip(span[1] * scale, width / 5, max_height))
    centre = View(np.zeros(2), heading, 1.0, 0, 0).world((low + high) / 2)
    return View(centre, heading, scale, width, height - height % 2)


def draw_car(
    canvas: Canvas,
    pose: Array,
    size: Array,
    colour: palette.Colour,
    edge: palette.Colour = palette.GROUND,
    edge_width: int = 1,
) -> None:
    """A filled box (length, width) at a pose (3,) of its centre, with a windscreen."""
    outline = boxes.bev_corners(pose, *size)
    canvas.polygon(outline, colour)
    # A dark band a third from the front tells front from rear at any scale.
    length, width = size[0] * 0.16, size[1] * 0.78
    ahead = size[0] * 0.20
    centre = pose + np.array([ahead * np.cos(pose[2]), ahead * np.sin(pose[2]), 0.0])
    canvas.polygon(boxes.bev_corners(centre, length, width), palette.dimmed(colour, 0.35))
    canvas.line(outline, edge, edge_width, closed=True)


def draw_scale_bar(canvas: Canvas, metres: float = 10.0, size: int = 17) -> None:
    """A bar of `metres` in the lower right corner; letters of `size` pixels."""
    right, y = canvas.view.width - 16.0, canvas.view.height - 1.3 * size
    left = right - metres * canvas.view.scale
    canvas.line(canvas.view.world([[left, y], [right, y]]), palette.TEXT, 2)
    canvas.text(((left + right) / 2, y - 5), f"{metres:.0f} m", palette.TEXT, size, "mb")
