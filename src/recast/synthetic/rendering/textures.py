"""Procedural textures on surfaces, in the surface's own frame, no finer than a pixel."""

from __future__ import annotations

import numpy as np

from recast.synthetic.rendering.embree import Float32Array
from recast.synthetic.rendering.surface_points import SurfacePoints


def textured(points: SurfacePoints, pixel_angle: float) -> Float32Array:
    """Diffuse colours (N, 3) with their textures."""
    return points.colour
