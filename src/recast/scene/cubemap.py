"""Sky cubemaps: looked up by direction, and as an equirectangular `SkyMap`.

Faces are +x, -x, +y, -y, +z, -z, addressed as OpenGL does it (and nvdiffrast, which both
published trainers use): a texel gx to the right and gy down, both in [-1, 1], lies in direction
(1, -gy, -gx), (-1, -gy, gx), (gx, 1, gy), (gx, -1, -gy), (gx, -gy, 1), (-gx, -gy, -1).
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as functional
from torch import Tensor

from recast.scene.sky import SkyMap

MAX_WIDTH = 2048
"""Of the map made: 0.18 degrees a column, 25 MB."""
FINER = 2
"""Samples a cell along each axis, whose mean its colour is."""

_AXES = ((0, 2, 1, -1, -1), (0, 2, 1, 1, -1), (1, 0, 2, 1, 1),
         (1, 0, 2, 1, -1), (2, 0, 1, 1, -1), (2, 0, 1, -1, -1))  # fmt: skip
"""By face: the axis it faces, the axes of gx and gy, and their signs."""


def sample_cubemap(faces: Tensor, directions: Tensor) -> Tensor:
    """Colours (M, 3) of faces (6, R, R, 3) in directions (M, 3) of any length.

    Bilinear within a face and held at its rim; seamless filtering differs there, by half a texel.
    Differentiable in the faces.
    """
    major = directions.abs().argmax(dim=1)
    chosen = directions.gather(1, major[:, None])[:, 0]
    face = 2 * major + (chosen < 0)
    colours = directions.new_empty(len(directions), 3)
    maps = faces.to(directions.dtype).movedim(-1, 1).unbind()
    for index, (axis, across, down, sign_x, sign_y) in enumerate(_AXES):
        rows = (face == index).nonzero()[:, 0]
        if len(rows) == 0:
            continue
        own = directions[rows] / directions[rows, axis].abs()[:, None]
        grid = torch.stack([sign_x * own[:, across], sign_y * own[:, down]], dim=-1)
        sampled = functional.grid_sample(
            maps[index][None],
            grid[None, None],
            padding_mode="border",
            align_corners=False,
        )
        colours[rows] = sampled[0, :, 0].T
    return colours


def texel_directions(size: int) -> Tensor:
    """Directions (6, R, R, 3) of the texels' centres, of any length, for faces of R = `size`."""
    centres = (torch.arange(size) + 0.5) / size * 2 - 1
    down, across = torch.meshgrid(centres, centres, indexing="ij")
    directions = torch.empty(6, size, size, 3)
    for index, (axis, axis_x, axis_y, sign_x, sign_y) in enumerate(_AXES):
        directions[index, ..., axis] = 1 - 2 * (index % 2)
        directions[index, ..., axis_x] = sign_x * across
        directions[index, ..., axis_y] = sign_y * down
    return directions


def sky_from_cubemap(faces: Tensor | None, cube_from_world: Tensor) -> SkyMap:
    """Resample a cubemap.

    Args:
        faces: (6, R, R, 3), or None for a black sky.
        cube_from_world: (3, 3) rotation (or exchange of axes) of directions.

    Returns:
        A map as wide as four faces, at most `MAX_WIDTH`, clamped to [0, 1].
    """
    if faces is None:
        return SkyMap.constant(torch.zeros(3))
    width = min(4 * faces.shape[1], MAX_WIDTH)
    height = max(width // 2, 1)
    turn = cube_from_world.to(torch.float32).T
    columns = (torch.arange(width * FINER) + 0.5) / (width * FINER)
    azimuth = (columns - 0.5) * (2 * math.pi)
    colours = torch.empty(height, width, 3)
    for row in range(height):
        shares = (row + (torch.arange(FINER) + 0.5) / FINER) / height
        elevation = ((0.5 - shares) * math.pi)[:, None]
        directions = torch.stack(
            [
                elevation.cos() * azimuth.cos(),
                elevation.cos() * azimuth.sin(),
                elevation.sin().expand(FINER, len(azimuth)),
            ],
            dim=-1,
        )
        fine = sample_cubemap(faces, directions.reshape(-1, 3) @ turn)
        colours[row] = fine.view(FINER, width, FINER, 3).mean(dim=(0, 2))
    return SkyMap(colours.clamp(0, 1))
