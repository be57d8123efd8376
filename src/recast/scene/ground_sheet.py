"""Even ground as a sheet: its Gaussians lie on the surface that the LiDAR found, flat on it.

Images from one lane do not tell how high a Gaussian of the road is: along its rays it may lie
anywhere. Left alone, a road becomes a cloud of 10 cm, and a lane marking seen from another lane
falls into strips. The LiDAR knows the surface to a centimetre or two.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from recast.logs import GroundHeight
from recast.splats import Gaussians
from recast.splats.rotations import quat_multiply, quat_to_matrix

SETTLE_EVERY = 10
"""Steps: what a Gaussian drifts meanwhile is millimetres."""
REACH_M = 0.25
"""Gaussians farther above or below belong to something else."""
THICKNESS_M = 0.015
"""Most standard deviation across the sheet."""


class GroundSheet:
    """The surface of even ground, and the Gaussians on it.

    Args:
        ground: heights; NaN where the ground is not even, where Gaussians are left alone.
        tolerance_m: most distance of a centre from the surface, metres.
        device: of the Gaussians.
    """

    def __init__(
        self, ground: GroundHeight, tolerance_m: float, device: torch.device | str = "cpu"
    ) -> None:
        self._tolerance, self._cell = tolerance_m, ground.cell
        self._origin = torch.from_numpy(ground.origin).to(device, torch.float32)
        self._height = torch.from_numpy(ground.height).to(device, torch.float32)

    def surface(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Heights (N,) and upward unit normals (N, 3) of the surface under points (N, >= 2).

        Bilinear between the centres of four cells; NaN where one of them is not even.
        """
        column, x, row, y, inside = self._cells(points)
        h00, h10 = self._height[row, column], self._height[row, column + 1]
        h01, h11 = self._height[row + 1, column], self._height[row + 1, column + 1]
        along_x = torch.lerp(h10 - h00, h11 - h01, y) / self._cell
        along_y = torch.lerp(h01 - h00, h11 - h10, x) / self._cell
        height = torch.lerp(torch.lerp(h00, h10, x), torch.lerp(h01, h11, x), y)
        normal = torch.stack([-along_x, -along_y, torch.ones_like(height)], dim=1)
        height = torch.where(inside, height, math.nan)
        return height, torch.nn.functional.normalize(normal, dim=1)

    def _perhaps_near(self, points: Tensor) -> Tensor:
        """Rows of points within reach of the surface, and a few more: cheap, by a single cell."""
        column, _, row, _, inside = self._cells(points)
        above = (points[:, 2] - self._height[row, column]).abs()
        return torch.nonzero(inside & (above < 2 * REACH_M))[:, 0]

    def _cells(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Column and share of the next one, row and share of the next one, whether all exist."""
        column_at, row_at = ((points[:, :2] - self._origin) / self._cell).unbind(dim=1)
        column, x, in_columns = _between(column_at, self._height.shape[1])
        row, y, in_rows = _between(row_at, self._height.shape[0])
        return column, x, row, y, in_columns & in_rows

    @torch.no_grad()
    def settle(self, gaussians: Gaussians) -> None:
        """Move Gaussians near the surface onto it, in place, their thinnest axis upright.

        Centres end within the tolerance of the surface, in height; the thinnest axis turns the
        shortest way to its normal and is at most `THICKNESS_M`. Colours and opacities stay.
        """
        rows = self._perhaps_near(gaussians.means)
        height, normal = self.surface(gaussians.means[rows])
        above = gaussians.means[rows, 2] - height
        near = torch.nonzero(above.abs() < REACH_M)[:, 0]  # NaN is not near
        rows, height, normal = rows[near], height[near], normal[near]
        held = above[near].clamp(-self._tolerance, self._tolerance)
        gaussians.means[rows, 2] = height + held
        scales = gaussians.log_scales[rows]
        thinnest = scales.argmin(dim=1, keepdim=True)
        gaussians.quats[rows] = _upright(gaussians.quats[rows], thinnest[:, 0], normal)
        thin = scales.gather(1, thinnest).clamp(max=math.log(THICKNESS_M))
        gaussians.log_scales[rows] = scales.scatter(1, thinnest, thin)


def _between(at: Tensor, cells: int) -> tuple[Tensor, Tensor, Tensor]:
    """First of the two cells (N,) about each place, the share of the second, whether both exist."""
    first = at.floor()
    inside = (first >= 0) & (first < cells - 1)
    return torch.where(inside, first, 0).long(), at - first, inside


def _upright(quats: Tensor, axis: Tensor, normal: Tensor) -> Tensor:
    """Quaternions (N, 4) turned the shortest way until an axis (N,) of each is along a normal.

    From unit vector a to b turns (1 + a . b, a x b), normalised; either end of the axis will do.
    """
    columns = quat_to_matrix(quats)
    now = columns.gather(2, axis[:, None, None].expand(-1, 3, 1))[..., 0]
    cosine = (now * normal).sum(dim=1, keepdim=True)
    now = torch.where(cosine < 0, -now, now)
    turn = torch.cat([1 + cosine.abs(), torch.linalg.cross(now, normal)], dim=1)
    return quat_multiply(torch.nn.functional.normalize(turn, dim=1), quats)
