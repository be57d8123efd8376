"""A stand-in for the package gsplat 1.5.3: its calling convention, drawn by our own reference.

It takes and gives what gsplat does (batches of cameras, activated scales and opacities, unpacked
results with rubbish in the rows of culled Gaussians), insists on what gsplat insists on, and knows
nothing of recast's arguments. So a mistake in the translation shows as a wrong picture or a wrong
gradient, without a GPU.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest
import torch
from torch import Tensor

from recast.splats import Gaussians, rasterization
from recast.splats.rasterization import TILE, RasterSettings

MAX_ALPHA = 0.99


def install(monkeypatch: pytest.MonkeyPatch, max_alpha: float = MAX_ALPHA) -> ModuleType:
    """Put the stand-in where `import gsplat` finds it, with a list `calls` of what it was given."""
    gsplat = ModuleType("gsplat")
    constants = ModuleType("gsplat.cuda._constants")
    constants.MAX_ALPHA = max_alpha
    gsplat.calls = []

    def rasterization(*arguments: Any, **options: Any) -> tuple[Tensor, Tensor, dict[str, Any]]:
        gsplat.calls.append(options)
        return _rasterization(max_alpha, *arguments, **options)

    gsplat.rasterization = rasterization
    monkeypatch.setitem(sys.modules, "gsplat", gsplat)
    monkeypatch.setitem(sys.modules, "gsplat.cuda._constants", constants)
    return gsplat


def _rasterization(
    max_alpha: float,
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    backgrounds: Tensor | None = None,
    render_mode: str = "RGB",
    absgrad: bool = False,
    rasterize_mode: str = "classic",
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    n = len(means)
    assert n > 0  # gsplat's tile count fails on none
    assert means.shape == (n, 3) and quats.shape == (n, 4) and scales.shape == (n, 3)
    assert opacities.shape == (n,) and sh_degree is not None
    assert colors.shape == (n, (sh_degree + 1) ** 2, 3)
    assert viewmats.shape == (1, 4, 4) and Ks.shape == (1, 3, 3)
    given = (means, quats, scales, opacities, colors, viewmats, Ks)
    assert all(tensor.dtype == torch.float32 for tensor in given)
    assert radius_clip == 0 and not packed and render_mode == "RGB+D"
    assert bool((scales > 0).all()) and bool(((opacities > 0) & (opacities < 1)).all())

    (fx, _, cx), (_, fy, cy) = Ks[0, :2].tolist()
    settings = RasterSettings(
        fx,
        fy,
        cx,
        cy,
        width,
        height,
        near_plane,
        far_plane,
        eps2d,
        rasterize_mode == "antialiased",
        max_alpha,
    )
    gaussians = Gaussians(means, quats, scales.log(), opacities.logit(), colors)
    splats = rasterization.project(gaussians, viewmats[0], settings)

    columns = range(0, width, TILE)
    rubbish = torch.full((1, n, 2), math.nan)
    means2d = rubbish.index_copy(1, splats.ids, splats.means2d[None])
    radii = torch.zeros(1, n, 2, dtype=torch.int32)
    radii[0, splats.ids] = splats.extents.ceil().int()
    sizes = torch.zeros(len(splats.ids), 2) if absgrad else None
    centres = means2d if sizes is None else _Sizes.apply(means2d, splats.ids, sizes)
    drawn = replace(splats, means2d=centres[0, splats.ids])
    rows = [
        torch.cat([rasterization.tile(drawn, x, y, settings, sizes) for x in columns], dim=1)
        for y in range(0, height, TILE)
    ]
    image = torch.cat(rows)[None]
    colours, alphas = image[..., :4], image[..., 4:]
    if backgrounds is not None:
        assert backgrounds.shape == (1, 3)
        behind = torch.cat([backgrounds, torch.zeros(1, 1)], dim=1)
        colours = colours + (1 - alphas) * behind[:, None, None]
    return colours, alphas, {"means2d": means2d, "radii": radii}


class _Sizes(torch.autograd.Function):
    """Hangs the absolute gradient on the tensor of the centres itself, in the backward pass."""

    @staticmethod
    def forward(ctx: Any, means2d: Tensor, ids: Tensor, sizes: Tensor) -> Tensor:
        ctx.save_for_backward(means2d)
        ctx.ids, ctx.sizes = ids, sizes
        return means2d.clone()

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        (means2d,) = ctx.saved_tensors
        means2d.absgrad = torch.zeros_like(gradient).index_copy_(1, ctx.ids, ctx.sizes[None])
        return gradient, None, None
