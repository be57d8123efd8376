"""Rendering on a GPU: gsplat (Ye et al. 2025) behind the semantics of `rasterize`."""

from __future__ import annotations

import warnings
import weakref
from importlib import import_module
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from recast.core.errors import InputError
from recast.splats.gaussians import Gaussians
from recast.splats.rasterization import Rasterization, RasterMeta, RasterSettings

INSTALL = "pip install 'recast-sim[cuda]'"
_MAX_ALPHA_1_5 = 0.999


def load_gsplat() -> ModuleType:
    """The module gsplat, its kernels built where this is the first call on this machine. Raises
    InputError: it is not installed, or has no kernels because it found no CUDA compiler."""
    try:
        gsplat = import_module("gsplat")
    except ImportError as error:
        raise InputError(
            "gsplat",
            "package",
            f"is needed for Gaussians on CUDA and cannot be imported ({error})",
            f"{INSTALL}, or keep them on the CPU",
        ) from None
    if _part("cuda._backend", "_C", gsplat) is None:
        raise InputError(
            "gsplat",
            "kernels",
            "are not built: it found no CUDA toolkit (nvcc)",
            "install the toolkit that torch was built for, or a gsplat wheel with kernels",
        )
    return gsplat


def max_alpha() -> float:
    """The cap on one Gaussian's alpha, which gsplat has built in: 0.999 up to 1.5, 0.99 since."""
    return float(_part("cuda._constants", "MAX_ALPHA", _MAX_ALPHA_1_5))


def _part(module: str, name: str, default: Any) -> Any:
    """A member of gsplat's insides, which not every version has."""
    try:
        return getattr(import_module(f"gsplat.{module}"), name, default)
    except ModuleNotFoundError:
        return default


def pick_device(name: str = "auto") -> torch.device:
    """The device to train and render on.

    Args:
        name: "cpu", "cuda", "cuda:1"; "auto" is CUDA where there are a GPU and gsplat, else the
            CPU, with a warning where only gsplat is missing.

    Raises:
        InputError: no such device, no such GPU here, or gsplat is missing.
    """
    if name == "auto":
        if not torch.cuda.is_available():
            return torch.device("cpu")
        try:
            load_gsplat()
        except InputError as error:
            warnings.warn(f"the GPU is not used: {error}", RuntimeWarning, stacklevel=2)
            return torch.device("cpu")
        return torch.device("cuda")
    mend = "choose auto, cpu or cuda"
    try:
        device = torch.device(name)
    except RuntimeError:
        raise InputError("device", name, "is unknown", mend) from None
    if device.type == "cpu":
        return device
    if device.type != "cuda":
        raise InputError("device", name, "has no rasterizer in recast", mend)
    if (device.index or 0) >= torch.cuda.device_count():
        raise InputError("device", name, f"torch sees {torch.cuda.device_count()} GPUs", mend)
    load_gsplat()
    return device


def rasterize_gsplat(
    gaussians: Gaussians,
    camera_from_world: Tensor,
    settings: RasterSettings,
    background: Tensor | None,
) -> Rasterization:
    """Render with gsplat; arguments as `rasterize`, checked by it.

    float32. As in the CPU kernel depth is the sum of T alpha z and gradients of projected centres
    are per pixel, absolute ones too; they reach `meta` if it is still held when the backward pass
    runs. `meta.visible` may have a few rows more, at the image's rim or between pixel centres, for
    gsplat rounds bounding boxes up; their gradients are zero. Of a window, it is that of the whole
    image.

    Raises:
        InputError: gsplat is missing.
        ValueError: a Gaussian is not finite or degenerate, or gsplat's cap on alpha is another.
    """
    gsplat = load_gsplat()
    if abs(settings.max_alpha - max_alpha()) > 1e-6:
        raise ValueError(
            f"rasterize: max_alpha {settings.max_alpha}: the installed gsplat has {max_alpha()} "
            "built in; leave it out"
        )
    means = gaussians.means.float()
    pose = camera_from_world.to(means)
    if len(gaussians) == 0:
        return _nothing(means, pose, settings, background)
    _check_values(gaussians)
    intrinsics = [[settings.fx, 0, settings.cx], [0, settings.fy, settings.cy], [0, 0, 1]]
    images, alphas, found = gsplat.rasterization(
        means=means,
        quats=gaussians.quats.float(),
        scales=gaussians.log_scales.float().exp(),
        opacities=gaussians.logit_opacities.float().sigmoid(),
        colors=gaussians.sh.float(),
        viewmats=pose[None],
        Ks=torch.tensor(intrinsics).to(means)[None],
        width=settings.width,
        height=settings.height,
        near_plane=settings.near,
        far_plane=settings.far,
        radius_clip=0.0,
        eps2d=settings.eps2d,
        sh_degree=gaussians.sh_degree,
        packed=False,
        backgrounds=None if background is None else background.to(means)[None],
        render_mode="RGB+D",
        absgrad=settings.absgrad,
        rasterize_mode="antialiased" if settings.antialiased else "classic",
    )
    meta = _meta(found["radii"][0], found["means2d"], settings.absgrad)
    # gsplat ties the limit of the projected tangent to the size that it draws: the whole is drawn.
    left, top, right, bottom = settings.drawn
    image, alpha = images[0, top:bottom, left:right], alphas[0, top:bottom, left:right, 0]
    return Rasterization(image[..., :3], image[..., 3], alpha, meta)


def _meta(radii: Tensor, means2d: Tensor, absgrad: bool) -> RasterMeta:
    """From radii (N, 2) and projected centres (1, N, 2) with their graph."""
    visible = (radii > 0).all(dim=1)
    # gsplat leaves the centres of culled rows as it found the memory.
    meta = RasterMeta(
        visible=visible,
        radii=torch.where(visible, radii.amax(dim=1), 0).float(),
        means2d=torch.where(visible[:, None], means2d.detach()[0], 0.0),
    )
    if means2d.requires_grad:
        wanted = weakref.ref(meta)
        # gsplat hangs absolute gradients on this very tensor, which nobody else holds by then. A
        # hook that holds its own tensor would live for ever: whoever drops `meta` drops it.
        held: list[Any] = [means2d] if absgrad else []
        weakref.finalize(meta, held.clear).atexit = False

        def keep_gradient(gradient: Tensor) -> None:
            meta = wanted()
            if meta is None:
                return
            meta.means2d_grad = gradient[0]
            if held:
                meta.means2d_absgrad = held[0].absgrad[0]

        means2d.register_hook(keep_gradient)
    return meta


def _check_values(gaussians: Gaussians) -> None:
    """Refuse what `Gaussians.validate` refuses, waiting for the device once."""
    if not bool(gaussians.in_range()):
        gaussians.validate()


def _nothing(
    means: Tensor, pose: Tensor, settings: RasterSettings, background: Tensor | None
) -> Rasterization:
    """The image of no Gaussians, which gsplat does not take; a backward pass finds zeros."""
    left, top, right, bottom = settings.drawn
    plane = means.new_zeros(bottom - top, right - left) + means.sum() + 0 * pose.sum()
    rgb = plane[..., None].repeat(1, 1, 3)
    if background is not None:
        rgb = rgb + background.to(means)
    none = means.new_zeros(0)
    meta = RasterMeta(visible=none.bool(), radii=none, means2d=means.new_zeros(0, 2))
    if plane.requires_grad:

        def keep_gradient(gradient: Tensor) -> None:
            meta.means2d_grad = gradient.new_zeros(0, 2)
            meta.means2d_absgrad = gradient.new_zeros(0, 2) if settings.absgrad else None

        plane.register_hook(keep_gradient)
    return Rasterization(rgb, plane, plane.clone(), meta)
