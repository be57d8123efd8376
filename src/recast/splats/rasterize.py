"""`rasterize`: the one door to 3D Gaussian splatting."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import torch
from torch import Tensor, device

from recast.splats import cuda, native
from recast.splats.cuda import rasterize_gsplat
from recast.splats.gaussians import Gaussians, concatenate, quat_to_matrix
from recast.splats.native.rasterizer import rasterize_native, rasterize_tables
from recast.splats.rasterization import (
    CLASSIC,
    LowPass,
    RasterImages,
    Rasterization,
    Window,
    check_pose,
    check_settings,
    check_shapes,
    rasterize_reference,
    refiltered,
)

Backend = Literal["auto", "native", "gsplat", "reference"]
DEVICE_OF = {"native": "cpu", "reference": "cpu", "gsplat": "cuda"}
"""The kind of device that each backend takes its Gaussians from."""
MAX_ALPHA = 0.99
"""Most opacity of the CPU's backends by default; gsplat's is built in."""


def rasterize(
    gaussians: Gaussians,
    camera_from_world: Tensor,
    K: Tensor,
    width: int,
    height: int,
    *,
    background: Tensor | None = None,
    near: float = 0.2,
    far: float = 1e10,
    eps2d: float = 0.3,
    antialiased: bool = False,
    max_alpha: float | None = None,
    absgrad: bool = False,
    window: Window | None = None,
    backend: Backend = "auto",
) -> Rasterization:
    """Render Gaussians by sorted alpha compositing; differentiable.

    Pixel centres are at +0.5. A Gaussian is drawn where its alpha is at least 1/255; a pixel stops
    before the Gaussian that would bring its transmittance to 1e-4 or below. The gradient reaches
    all fields of `gaussians`, `camera_from_world` and `background`; that of the pose is taken
    through its upper 3x4 entries and is meant to be projected to the tangent of SE(3).

    Args:
        gaussians: N Gaussians in the world frame, all fields on one device. Images and `meta` are
            given there; pose and background may lie on the CPU all the same.
        camera_from_world: (4, 4) rigid, OpenCV axes (x right, y down, z forward).
        K: (3, 3) pinhole intrinsics in pixels, without skew. Not differentiated.
        width: width of the whole image, pixels.
        height: height of the whole image, pixels.
        background: (3,) colour behind everything; black when None.
        near: Gaussians with centres nearer than this are not drawn, metres.
        far: likewise beyond this.
        eps2d: variance of the low-pass filter added to every projected covariance, px^2.
        antialiased: lower the opacity so that the filter keeps a Gaussian's integral
            (Mip-Splatting); else the classic 3DGS behaviour.
        max_alpha: cap on the alpha of one Gaussian; None is 0.99 on the CPU, as in 3DGS, and on
            CUDA what gsplat has built in (`cuda.max_alpha`: 0.999 in 1.5.3), the only one it takes.
        absgrad: give `meta.means2d_absgrad` as well (Ye et al. 2024, AbsGS): in the plain gradient
            pixels that pull a Gaussian in opposite directions cancel.
        window: the part of the image to draw; None for all of it. `K`, `width` and `height` stay
            those of the whole image, and the pixels are those that it has there.
        backend: "native" the compiled kernel (float32, CPU), "gsplat" the package of that name
            (float32, CUDA), "reference" plain torch in the dtype of the Gaussians (CPU), "auto"
            gsplat on CUDA, on the CPU the kernel where it is there.

    Raises:
        ValueError: an argument is at fault: a shape, a device, a value that is not finite, a pose
            that is not rigid, a quaternion of norm zero.
        InputError: the Gaussians are on CUDA and gsplat is not installed.
        RuntimeError: backend is "native" and there is none; the message says why.
    """
    if backend == "auto":
        backend = _choose(gaussians.means.device)
    if backend not in DEVICE_OF:
        known = ", ".join(("auto", *DEVICE_OF))
        raise ValueError(f"rasterize: backend {backend!r}, expected one of {known}")
    check_shapes(gaussians, DEVICE_OF[backend])
    if max_alpha is None:
        max_alpha = cuda.max_alpha() if backend == "gsplat" else MAX_ALPHA
    settings = check_settings(
        camera_from_world,
        K,
        background,
        width=width,
        height=height,
        near=near,
        far=far,
        eps2d=eps2d,
        antialiased=antialiased,
        max_alpha=max_alpha,
        absgrad=absgrad,
        window=window,
    )
    if backend == "gsplat":
        return rasterize_gsplat(gaussians, camera_from_world, settings, background)
    if backend == "native":
        return rasterize_native(gaussians, camera_from_world, settings, background)
    return rasterize_reference(gaussians, camera_from_world, settings, background)


def rasterize_frozen(
    parts: Sequence[tuple[FrozenGaussians, Tensor]],
    camera_from_world: Tensor,
    K: Tensor,
    width: int,
    height: int,
    *,
    background: Tensor | None = None,
    near: float = 0.2,
    far: float = 1e10,
    max_alpha: float | None = None,
    window: Window | None = None,
    backend: Backend = "auto",
) -> RasterImages:
    """Render frozen Gaussians, each part where its pose puts it; not differentiable.

    The image is that of `rasterize` of all parts moved to the world and concatenated, up to
    rounding and to the half precision of colours. The compiled kernel moves nothing: it looks at
    each part from its own frame and through its own filter, skips blocks out of view, and reads
    what `freeze` worked out. Elsewhere a pass has one filter, that of the first part, and the other
    parts are `refiltered`.

    Args:
        parts: each with `world_from_part` (4, 4), rigid. At least one.
        camera_from_world, K, width, height: and all others as of `rasterize`.

    Raises:
        ValueError, InputError, RuntimeError: as `rasterize`; or there is no part.
    """
    if not parts:
        raise ValueError("rasterize_frozen: no part given")
    if backend == "auto":
        backend = _choose(parts[0][0].gaussians.means.device)
    if backend != "native" or any(part.tables is None for part, _ in parts):
        drawn_by = parts[0][0].low_pass
        given = (drawn_by, camera_from_world, K)
        world = concatenate([in_world(part, pose, *given) for part, pose in parts])
        with torch.no_grad():
            return rasterize(
                world,
                camera_from_world.to(world.means.dtype),
                K,
                width,
                height,
                background=background,
                near=near,
                far=far,
                eps2d=drawn_by.variance,
                antialiased=drawn_by.antialiased,
                max_alpha=max_alpha,
                window=window,
                backend=backend,
            )
    settings = check_settings(
        camera_from_world,
        K,
        background,
        width=width,
        height=height,
        near=near,
        far=far,
        eps2d=CLASSIC.variance,  # each part has its own
        antialiased=CLASSIC.antialiased,
        max_alpha=MAX_ALPHA if max_alpha is None else max_alpha,
        window=window,
    )
    tables: list[tuple[FrozenTables, LowPass, Tensor]] = []
    for part, world_from_part in parts:
        if part.tables is not None:
            check_pose(world_from_part, "world_from_part")
            pose = camera_from_world.double() @ world_from_part.double()
            tables.append((part.tables, part.low_pass, pose))
    return rasterize_tables(tables, settings, background)


def _choose(where: device) -> Backend:
    if where.type == DEVICE_OF["gsplat"]:
        return "gsplat"
    if native.info().available:
        return "native"
    _warn_once(native.info().reason)
    return "reference"


@lru_cache(maxsize=1)
def _warn_once(reason: str) -> None:
    warnings.warn(
        f"no native rasterizer ({reason}); using the torch reference, hundreds of times slower",
        RuntimeWarning,
        stacklevel=3,
    )


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
    """B blocks of Gaussians as the compiled kernel reads them: by column, 16 at a time."""

    # (8 B, 13, 16) float32: centre, rotation times scale by row, log2 of the opacity.
    geometry: Tensor
    colours: Tensor  # (8 B, 3 K, 16) float16: harmonics
    # (B, 5) float32: centre and radius of a sphere around the centres, largest scale.
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
        Raises ValueError: a shape is wrong, or a value is not finite."""
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
