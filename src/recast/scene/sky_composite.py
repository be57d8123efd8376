"""`sky.composite` for training: fused with its gradient."""

from __future__ import annotations

import ctypes
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from recast.kernel import KernelSky, library
from recast.scene.sky import OPAQUE, composite
from recast.splats.native.rasterizer import empty, takes


def fused_composite(rgb: Tensor, alpha: Tensor, colours: Tensor, coordinates: Tensor) -> Tensor:
    """As `sky.composite`, by the compiled kernel for float32 on the CPU and by that for all else.

    Raises:
        ValueError: the shapes do not belong together.
    """
    given = rgb, alpha, colours, coordinates
    shapes = tuple(tuple(one.shape) for one in given)
    size = shapes[1]
    fine = len(size) == 2 and (shapes[0], shapes[3]) == ((*size, 3), (*size, 2))
    if not fine or len(shapes[2]) != 3 or shapes[2][2] != 3 or colours.numel() == 0:
        raise ValueError(f"fused_composite: image, opacity, sky, coordinates of shapes {shapes}")
    if takes(*given):
        return _Fused.apply(*(one.contiguous() for one in given))
    return composite(*given)


class _Fused(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, rgb: Tensor, alpha: Tensor, colours: Tensor, coordinates: Tensor
    ) -> Tensor:
        image = empty(*rgb.shape)
        call = _call(alpha, colours, coordinates)
        call.rgb, call.image = rgb.data_ptr(), image.data_ptr()
        library().recast_sky(ctypes.byref(call))
        ctx.save_for_backward(alpha, colours, coordinates)
        return image

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, image_grad: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        alpha, colours, coordinates = ctx.saved_tensors
        given = image_grad.contiguous()
        alpha_grad, colours_grad = empty(*alpha.shape), torch.zeros_like(colours)
        call = _call(alpha, colours, coordinates)
        call.image_grad = given.data_ptr()
        call.alpha_grad, call.colours_grad = alpha_grad.data_ptr(), colours_grad.data_ptr()
        library().recast_sky_backward(ctypes.byref(call))
        return image_grad, alpha_grad, colours_grad, None


def _call(alpha: Tensor, colours: Tensor, coordinates: Tensor) -> KernelSky:
    return KernelSky(
        alpha=alpha.data_ptr(),
        colours=colours.data_ptr(),
        coordinates=coordinates.data_ptr(),
        pixels=alpha.numel(),
        height=colours.shape[0],
        width=colours.shape[1],
        opaque=OPAQUE,
    )
