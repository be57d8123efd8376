"""The compiled rasterizer as a differentiable torch function; its working memory recycled."""

from __future__ import annotations

import ctypes
import math
import threading
import weakref
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from recast.kernel import Gradients, KernelPart, KernelView, find, library
from recast.splats.gaussians import Gaussians
from recast.splats.rasterization import (
    LowPass,
    RasterImages,
    Rasterization,
    RasterMeta,
    RasterSettings,
)

if TYPE_CHECKING:
    from recast.splats.rasterize import FrozenTables

_KEEP = 16
_LINE = 64  # bytes of a cache line: the kernel writes large gradients by whole lines
_store: list[np.ndarray] = []
_store_lock = threading.Lock()
# Blocks come back whenever Python collects a tensor, even while the lock is held: they wait here.
_returned: deque[np.ndarray] = deque()
_idle: list[int] = []  # native contexts that no view holds
STAGES = ("project", "sort", "bin", "raster", "raster_backward", "project_backward")
"""Stages of a pass, as they are timed."""
MOST_AT_ONCE = 1 << 24
"""Pairs of a Gaussian and a tile that are listed together: 0.13 GB, and 0.7 GB of gradients; an
image with more is worked on in bands."""

# Order of `Fault` in frame.hpp.
_FAULTS = {
    1: ("means", "is not finite, or beyond 1e15"),
    2: ("quats", "is not finite"),
    3: ("log_scales", "is not finite, or out of -60..14"),
    4: ("logit_opacities", "is not finite, or beyond 1e15"),
    5: ("sh", "is not finite"),
    6: ("quats", "has a norm out of 1e-15..1e15"),
}


def rasterize_native(
    gaussians: Gaussians,
    camera_from_world: Tensor,
    settings: RasterSettings,
    background: Tensor | None,
) -> Rasterization:
    """Render with the compiled kernel; arguments as `rasterize`, checked by it."""
    n = len(gaussians)
    meta = RasterMeta(
        visible=empty(n, dtype=torch.bool), radii=empty(n), means2d=empty(n, 2), means2d_grad=None
    )
    parameters = [
        tensor.float().contiguous()
        for tensor in (
            gaussians.means,
            gaussians.quats,
            gaussians.log_scales,
            gaussians.logit_opacities,
            gaussians.sh,
        )
    ]
    rgb, depth, alpha = _Rasterize.apply(*parameters, camera_from_world, background, settings, meta)
    return Rasterization(rgb, depth, alpha, meta)


def run_forward(
    workspace: Workspace,
    parameters: tuple[Tensor, ...],
    pose: Tensor,
    background: Tensor | None,
    settings: RasterSettings,
    meta: RasterMeta,
    training: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """One forward pass: rgb, depth, alpha; `meta` is filled in. Raises ValueError: a Gaussian is
    not finite or degenerate."""
    means, quats, log_scales, logits, sh = parameters
    images = _images(settings)
    view = _view(settings, background, images)
    view.count, view.sh_bases, view.training = means.shape[0], sh.shape[1], training
    view.rotation, view.translation = _rigid(pose)
    view.means, view.quats, view.sh = means.data_ptr(), quats.data_ptr(), sh.data_ptr()
    view.log_scales, view.logits = log_scales.data_ptr(), logits.data_ptr()
    view.visible, view.radii = meta.visible.data_ptr(), meta.radii.data_ptr()
    view.means2d = meta.means2d.data_ptr()
    row = ctypes.c_int64()
    status = library().recast_forward(workspace.handle, ctypes.byref(view), ctypes.byref(row))
    if status > 0:
        field, problem = _FAULTS[status]
        raise ValueError(f"Gaussians.{field}: row {row.value} {problem}")
    _check(status)
    return images


def rasterize_tables(
    parts: Sequence[tuple[FrozenTables, LowPass, Tensor]],
    settings: RasterSettings,
    background: Tensor | None,
) -> RasterImages:
    """Render frozen parts, each through its filter, with its `camera_from_part` (4, 4)."""
    images = _images(settings)
    view = _view(settings, background, images)
    given = (KernelPart * len(parts))()
    for part, (tables, low_pass, pose) in zip(given, parts, strict=True):
        part.blocks, part.sh_bases = len(tables.bounds), tables.colours.shape[1] // 3
        part.geometry, part.colours = tables.geometry.data_ptr(), tables.colours.data_ptr()
        part.bounds = tables.bounds.data_ptr()
        part.eps2d, part.antialiased = low_pass.variance, low_pass.antialiased
        part.rotation, part.translation = _rigid(pose)
    handle = Workspace().handle
    _check(library().recast_forward_frozen(handle, ctypes.byref(view), given, len(parts)))
    return RasterImages(*images)


def _images(settings: RasterSettings) -> tuple[Tensor, Tensor, Tensor]:
    left, top, right, bottom = settings.drawn
    height, width = bottom - top, right - left
    return empty(height, width, 3), empty(height, width), empty(height, width)


def _rigid(pose: Tensor) -> tuple[ctypes.Array[ctypes.c_float], ctypes.Array[ctypes.c_float]]:
    matrix = pose.detach().double().cpu()
    rotation = (ctypes.c_float * 9)(*matrix[:3, :3].flatten().tolist())
    return rotation, (ctypes.c_float * 3)(*matrix[:3, 3].tolist())


def _view(
    settings: RasterSettings, background: Tensor | None, images: tuple[Tensor, Tensor, Tensor]
) -> KernelView:
    rgb, depth, alpha = images
    left, top, right, bottom = settings.drawn
    return KernelView(
        width=right - left,
        height=bottom - top,
        left=left,
        top=top,
        whole_width=settings.width,
        whole_height=settings.height,
        antialiased=settings.antialiased,
        most_at_once=MOST_AT_ONCE,
        near=settings.near,
        far=settings.far,
        eps2d=settings.eps2d,
        max_alpha=settings.max_alpha,
        fx=settings.fx,
        fy=settings.fy,
        cx=settings.cx,
        cy=settings.cy,
        background=(ctypes.c_float * 3)(*([] if background is None else background.tolist())),
        rgb=rgb.data_ptr(),
        depth=depth.data_ptr(),
        alpha=alpha.data_ptr(),
    )


def _check(status: int) -> None:
    if status == -1:
        raise ValueError(
            "rasterize: the Gaussians cover more than 2^32 tiles of one row: scales too large"
        )
    if status:
        raise MemoryError("rasterize: out of memory")


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> tuple[Tensor, Tensor, Tensor]:
        *parameters, pose, background, settings, meta = arguments
        training = any(ctx.needs_input_grad)
        workspace = Workspace()
        images = run_forward(
            workspace, tuple(parameters), pose, background, settings, meta, training
        )
        if training:
            ctx.set_materialize_grads(False)
            ctx.save_for_backward(*parameters, pose, background, images[2])
            ctx.workspace, ctx.settings, ctx.meta = workspace, settings, meta
        return images

    @staticmethod
    def backward(ctx: Any, *image_grads: Any) -> tuple[Any, ...]:
        *parameters, pose, background, alpha = ctx.saved_tensors
        if ctx.workspace is None:  # a second pass through a retained graph
            ctx.workspace = Workspace()
            run_forward(
                ctx.workspace, parameters, pose, background, ctx.settings, ctx.meta, training=True
            )
        given = [None if g is None else g.float().contiguous() for g in image_grads]
        gradients = [empty(*p.shape) for p in parameters]
        n = parameters[0].shape[0]
        means2d_grad = empty(n, 2)
        means2d_absgrad = empty(n, 2) if ctx.settings.absgrad else None
        pose_grad = torch.zeros(4, 4)
        names = ("means", "quats", "log_scales", "logits", "sh")
        structure = Gradients(
            **{name: p.data_ptr() for name, p in zip(names, parameters, strict=True)},
            **{
                name: None if g is None else g.data_ptr()
                for name, g in zip(("rgb", "depth", "alpha"), given, strict=True)
            },
            **{f"{name}_grad": g.data_ptr() for name, g in zip(names, gradients, strict=True)},
            means2d_grad=means2d_grad.data_ptr(),
            pose_grad=pose_grad.data_ptr(),
            means2d_absgrad=None if means2d_absgrad is None else means2d_absgrad.data_ptr(),
        )
        if library().recast_backward(ctx.workspace.handle, ctypes.byref(structure)):
            raise MemoryError("rasterize: out of memory")
        # The graph may live on until the next step is built: the memory is needed there.
        ctx.workspace = None
        ctx.meta.means2d_grad = means2d_grad
        ctx.meta.means2d_absgrad = means2d_absgrad

        background_grad = None
        if background is not None and ctx.needs_input_grad[6]:
            background_grad = torch.zeros_like(background)
            if given[0] is not None:
                through = (given[0] * (1 - alpha)[..., None]).sum(dim=(0, 1))
                background_grad = through.to(background)
        wanted = [
            g if need else None for g, need in zip(gradients, ctx.needs_input_grad, strict=False)
        ]
        return (*wanted, pose_grad.to(pose), background_grad, None, None)


class Workspace:
    """The memory of one view from its forward to its backward pass.

    Whoever holds the object owns the memory; when it is collected, the native context (tens to
    hundreds of MB) is kept for the next view instead of being freed.
    """

    def __init__(self) -> None:
        try:
            handle = _idle.pop()
        except IndexError:
            handle = library().recast_create()
        if not handle:
            raise MemoryError("rasterize: no memory for a native context")
        self.handle: int = handle
        weakref.finalize(self, _idle.append, handle).atexit = False

    def timings(self) -> dict[str, float]:
        """CPU milliseconds of each stage of the last passes, all threads together."""
        values = (ctypes.c_double * len(STAGES))()
        library().recast_timings(self.handle, values)
        return dict(zip(STAGES, values, strict=True))

    def nbytes(self) -> int:
        """Bytes held."""
        return int(library().recast_bytes(self.handle))

    def intersections(self) -> int:
        """Pairs of a Gaussian and a tile in the last forward pass."""
        return int(library().recast_intersections(self.handle))


def free_memory() -> None:
    """Free the working memory that no view and no tensor holds."""
    with _store_lock:
        _returned.clear()
        _store.clear()
    while _idle:
        library().recast_destroy(_idle.pop())


def takes(*tensors: Tensor) -> bool:
    """Whether the compiled kernel is there and reads such tensors: float32 on the CPU."""
    read = all(one.device.type == "cpu" and one.dtype == torch.float32 for one in tensors)
    return read and find() is not None


def empty(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """A tensor with undefined content, its memory taken from the store where a block fits.

    A fresh large tensor costs a page fault every 4 kB, which at some hundred thousand Gaussians is
    as slow as computing its content. Tensors given out here own their memory like any other; when
    the last reference goes, the memory goes back to the store, not to the operating system.
    """
    size = dtype.itemsize * math.prod(shape)
    block = _take(size)
    lease = block.view()
    weakref.finalize(lease, _returned.append, block).atexit = False
    flat: Tensor = torch.from_numpy(lease)[:size].view(dtype)
    return flat.view(shape)


def _take(size: int) -> np.ndarray:
    with _store_lock:
        while _returned:
            _store.append(_returned.popleft())
        best = -1
        for i, block in enumerate(_store):
            # A much larger block would be missing elsewhere.
            fits = size <= block.nbytes <= 1.5 * size + 4096
            if fits and (best < 0 or block.nbytes < _store[best].nbytes):
                best = i
        if best >= 0:
            return _store.pop(best)
        del _store[: max(0, len(_store) - _KEEP)]
    block = np.empty(size + size // 8 + 2 * _LINE, np.uint8)
    return block[-block.ctypes.data % _LINE :]
