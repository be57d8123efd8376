"""Gaussians that are drawn again and again: what the kernel needs is worked out once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from recast.splats import native
from recast.splats.gaussians import Gaussians, quat_to_matrix
from recast.splats.low_pass import LowPass, refiltered

BLOCK = 128
"""Gaussians that are culled together (`kFrozenBlock` of frame.hpp)."""
LANES = 16
"""Gaussians that lie together, by column (`kFrozenLanes` of frame.hpp)."""
_LARGEST_HALF = 65504.0
_UNSEEN = -1e4
"""log2 of the opacity of what fills up the last block."""
_ROUNDING = 1 + 1e-5
"""Bounds are that much wider than what they were computed from."""


@dataclass(frozen=True)
class FrozenTables:
    """B blocks of Gaussians as the compiled kernel reads them: by column, 16 at a time.

    Attributes:
        geometry: (8 B, 13, 16) float32: centre, rotation times scale by row, log2 of the opacity.
        colours: (8 B, 3 K, 16) float16: harmonics.
        bounds: (B, 5) float32: centre and radius of a sphere around the centres, largest scale.
    """

    geometry: Tensor
    colours: Tensor
    bounds: Tensor


@dataclass(frozen=True)
class FrozenGaussians:
    """A set of Gaussians in a frame of its own, for `recast.splats.rasterize_frozen`.

    Attributes:
        gaussians: N Gaussians.
        tables: for the compiled kernel; None where it is not there or does not draw them.
    """

    gaussians: Gaussians
    tables: FrozenTables | None

    def refiltered(
        self, made_for: LowPass, drawn_by: LowPass, camera_from_local: Tensor, K: Tensor
    ) -> FrozenGaussians:
        """See `recast.splats.refiltered`; colours stay as they are."""
        if made_for == drawn_by:
            return self
        changed = refiltered(self.gaussians, made_for, drawn_by, camera_from_local, K)
        if self.tables is None:
            return FrozenGaussians(changed, None)
        return FrozenGaussians(changed, _tables(changed, self.tables.colours))


def freeze(gaussians: Gaussians) -> FrozenGaussians:
    """Work out once what drawing needs.

    Blocks of 128 neighbours in the order given are culled together: the order along a Morton curve
    (`recast.splats.morton_order`) makes them small. Colours are kept in half precision on the CPU:
    images stay within a grey level.

    Raises:
        ValueError: a field is at fault, see `Gaussians.fault`.
    """
    gaussians = gaussians.detach()
    gaussians.validate()
    if gaussians.means.device.type != "cpu" or not native.info().available:
        return FrozenGaussians(gaussians, None)
    colours = gaussians.sh.flatten(1).clamp(-_LARGEST_HALF, _LARGEST_HALF).half()
    return FrozenGaussians(gaussians, _tables(gaussians, _columns(colours)))


def _tables(gaussians: Gaussians, colours: Tensor) -> FrozenTables:
    means = gaussians.means.float()
    scales = gaussians.log_scales.float().exp()
    axes = quat_to_matrix(gaussians.quats.float()) * scales[:, None, :]
    opacities = torch.nn.functional.logsigmoid(gaussians.logit_opacities.double()) / math.log(2)
    rows = _filled(torch.cat([means, axes.flatten(1), opacities.float()[:, None]], dim=1))
    rows[len(means) :, -1] = _UNSEEN
    centres = rows[:, :3].unflatten(0, (-1, BLOCK))
    middle = (centres.amin(dim=1) + centres.amax(dim=1)) / 2
    radius = (centres - middle[:, None]).norm(dim=2).amax(dim=1) * _ROUNDING
    largest = _filled(scales).amax(dim=1).unflatten(0, (-1, BLOCK)).amax(dim=1) * _ROUNDING
    bounds = torch.cat([middle, radius[:, None], largest[:, None]], dim=1)
    return FrozenTables(_columns(rows), colours, bounds.contiguous())


def _filled(rows: Tensor) -> Tensor:
    """Rows (N, C), the last one repeated to the end of its block."""
    whole = -(-len(rows) // BLOCK) * BLOCK
    return rows[torch.arange(whole).clamp(max=len(rows) - 1)]


def _columns(rows: Tensor) -> Tensor:
    """(N, C) -> (8 B, C, LANES)."""
    return _filled(rows).unflatten(0, (-1, LANES)).transpose(1, 2).contiguous()


def in_world(part: FrozenGaussians, world_from_part: Tensor) -> Gaussians:
    """The Gaussians of a part where it stands."""
    if torch.equal(world_from_part, torch.eye(4).to(world_from_part)):
        return part.gaussians
    return part.gaussians.transformed(world_from_part)
