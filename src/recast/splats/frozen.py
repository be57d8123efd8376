"""Gaussians that are drawn again and again: what the kernel needs is worked out once."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from recast.splats import native
from recast.splats.gaussians import Gaussians, quat_to_matrix
from recast.splats.low_pass import CLASSIC, LowPass, refiltered

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
        low_pass: filter that they were made for, and through which they are drawn.
        tables: tables for the compiled kernel; None where it is not there or does not draw them.
    """

    gaussians: Gaussians
    low_pass: LowPass
    tables: FrozenTables | None

    def recoloured(self, sh: Tensor) -> FrozenGaussians:
        """The same with other harmonics (N, K, 3); what hangs on shapes is not worked out again.

        Raises:
            ValueError: a shape is wrong, or a value is not finite.
        """
        changed = replace(self.gaussians, sh=sh.detach())
        if sh.shape[:1] != self.gaussians.sh.shape[:1] or not bool(torch.isfinite(sh).all()):
            changed.validate()
        tables = self.tables and replace(self.tables, colours=_halves(changed.sh))
        return replace(self, gaussians=changed, tables=tables)


def freeze(gaussians: Gaussians, low_pass: LowPass = CLASSIC) -> FrozenGaussians:
    """Work out once what drawing needs.

    Blocks of 128 neighbours in the order given are culled together: the order along a Morton curve
    (`recast.splats.morton_order`) makes them small. Colours are kept in half precision on the CPU:
    images stay within a grey level.

    Args:
        low_pass: filter that the Gaussians were made for.

    Raises:
        ValueError: a field is at fault, see `Gaussians.fault`.
    """
    gaussians = gaussians.detach()
    gaussians.validate()
    if gaussians.means.device.type != "cpu" or not native.info().available:
        return FrozenGaussians(gaussians, low_pass, None)
    return FrozenGaussians(gaussians, low_pass, _tables(gaussians))


def _halves(sh: Tensor) -> Tensor:
    """(N, K, 3) -> (8 B, 3 K, LANES) float16."""
    return _columns(sh.flatten(1).clamp(-_LARGEST_HALF, _LARGEST_HALF).half())


def _tables(gaussians: Gaussians) -> FrozenTables:
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
    return FrozenTables(_columns(rows), _halves(gaussians.sh), bounds.contiguous())


def _filled(rows: Tensor) -> Tensor:
    """Rows (N, C), the last one repeated to the end of its block."""
    whole = -(-len(rows) // BLOCK) * BLOCK
    return rows[torch.arange(whole).clamp(max=len(rows) - 1)]


def _columns(rows: Tensor) -> Tensor:
    """(N, C) -> (8 B, C, LANES)."""
    return _filled(rows).unflatten(0, (-1, LANES)).transpose(1, 2).contiguous()


def in_world(
    part: FrozenGaussians,
    world_from_part: Tensor,
    drawn_by: LowPass,
    camera_from_world: Tensor,
    K: Tensor,
) -> Gaussians:
    """The Gaussians of a part where it stands, for a pass with one filter for all parts."""
    found = part.gaussians
    if not torch.equal(world_from_part, torch.eye(4).to(world_from_part)):
        found = found.transformed(world_from_part)
    return refiltered(found, part.low_pass, drawn_by, camera_from_world, K)
