"""The image loss: L1 and SSIM of a rendered view against the recorded one."""

from __future__ import annotations

import ctypes
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from recast.kernel import Photometric, library
from recast.scene.scores import C1, C2, WINDOW, ssim_map, window
from recast.splats.native.rasterizer import empty, takes


def photometric_loss(image: Tensor, target: Tensor, ssim_weight: float = 0.2) -> Tensor:
    """(1 - w) mean |x - y| + w (1 - mean SSIM) of images (H, W, 3) in [0, 1].

    Zhao et al. 2017 as used by 3D Gaussian splatting (eq. 7). Differentiable in `image` only. The
    compiled kernel does it for float32 on the CPU; elsewhere, and where there is none, it is
    `photometric_reference`.

    Raises:
        ValueError: the images are not of one shape (H, W, 3).
    """
    if image.shape != target.shape or image.ndim != 3 or image.shape[2] != 3:
        shapes = f"{tuple(image.shape)} and {tuple(target.shape)}"
        raise ValueError(f"photometric_loss: images {shapes}, expected one shape (H, W, 3)")
    if takes(image, target):
        return _Fused.apply(image.contiguous(), target.contiguous(), ssim_weight)
    return photometric_reference(image, target.detach(), ssim_weight)


def photometric_reference(image: Tensor, target: Tensor, ssim_weight: float) -> Tensor:
    """`photometric_loss` in torch, for any device and type."""
    similarity = ssim_map(image, target).mean()
    return (1 - ssim_weight) * (image - target).abs().mean() + ssim_weight * (1 - similarity)


class _Fused(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, image: Tensor, target: Tensor, ssim_weight: float) -> Tensor:
        maps = [empty(*image.shape) for _ in range(3)]
        sums = torch.empty(image.shape[0], 2, dtype=torch.float64)
        call = _call(image, target, maps)
        call.sums = sums.data_ptr()
        library().recast_photometric(ctypes.byref(call))
        ctx.save_for_backward(image, target, *maps)
        ctx.ssim_weight = ssim_weight
        difference, similarity = (sums.sum(dim=0) / image.numel()).tolist()
        return image.new_tensor((1 - ssim_weight) * difference + ssim_weight * (1 - similarity))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, loss_grad: Tensor) -> tuple[Tensor, None, None]:
        image, target, *maps = ctx.saved_tensors
        gradient = empty(*image.shape)
        call = _call(image, target, maps)
        factor = float(loss_grad) / image.numel()
        call.gradient = gradient.data_ptr()
        call.l1, call.ssim = (1 - ctx.ssim_weight) * factor, -ctx.ssim_weight * factor
        library().recast_photometric_backward(ctypes.byref(call))
        return gradient, None, None


def _call(image: Tensor, target: Tensor, maps: list[Tensor]) -> Photometric:
    height, width, channels = image.shape
    by_mean, by_square, by_product = (one.data_ptr() for one in maps)
    return Photometric(
        image=image.data_ptr(),
        target=target.data_ptr(),
        by_mean=by_mean,
        by_square=by_square,
        by_product=by_product,
        height=height,
        row=width * channels,
        window=(ctypes.c_float * (WINDOW // 2 + 1))(*window()[: WINDOW // 2 + 1].tolist()),
        c1=C1,
        c2=C2,
    )
