"""Small random Gaussians before a camera, and rendering them with a loss for tests."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from recast.splats import Gaussians, Rasterization, RasterMeta, rasterize
from recast.splats.gaussians import quat_to_matrix

WIDTH, HEIGHT = 90, 61  # not whole tiles
K = torch.tensor([[70.0, 0, 44], [0, 72, 31], [0, 0, 1]])
KINDS = ("normal", "opaque", "needles")


def camera() -> Tensor:
    """camera_from_world (4, 4), a little off the axes."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = quat_to_matrix(torch.tensor([1, 0.05, -0.03, 0.02], dtype=torch.float64))
    pose[:3, 3] = torch.tensor([0.1, -0.2, 0.3])
    return pose


def random_gaussians(kind: str, count: int = 600, seed: int = 0, degree: int = 3) -> Gaussians:
    """Gaussians in and around the view: "opaque" ones large and dense, "needles" 100 to 1."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    depth = torch.rand(count, generator=generator) * 8 + 0.5
    means = torch.stack([normal(count) * 2.5, normal(count) * 1.6, depth], dim=1)
    log_scales = normal(count, 3) * 0.5 - 2.4
    logits = normal(count) * 1.5
    if kind == "opaque":
        log_scales, logits = log_scales + 0.8, logits + 3
    if kind == "needles":
        log_scales = normal(count, 3) * 0.2 - 4.6
        log_scales[:, 0] += math.log(100)
    sh = normal(count, (degree + 1) ** 2, 3) * 0.3
    return Gaussians(means, normal(count, 4), log_scales, logits, sh)


@dataclass(frozen=True)
class Outcome:
    """A rendering, and the gradients of a random linear loss by name."""

    image: Rasterization
    gradients: dict[str, Tensor]


def render_with_gradients(
    gaussians: Gaussians,
    backend: str,
    dtype: torch.dtype,
    background: Tensor | None = None,
    device: str = "cpu",
    **options: object,
) -> Outcome:
    """Render and differentiate sum(random * (rgb, depth, alpha)) in `dtype`; results on the CPU."""
    generator = torch.Generator().manual_seed(5)
    weights = torch.randn(HEIGHT, WIDTH, 5, generator=generator).to(device, dtype)
    leaves = Gaussians(
        **{
            name: v.to(device, dtype, copy=True).requires_grad_()
            for name, v in vars(gaussians).items()
        }
    )
    pose = camera().to(dtype).requires_grad_()
    extra = {}
    if background is not None:
        extra["background"] = background.to(dtype).clone().requires_grad_()
    image = rasterize(leaves, pose, K, WIDTH, HEIGHT, backend=backend, **extra, **options)
    channels = torch.cat([image.rgb, image.depth[..., None], image.alpha[..., None]], dim=-1)
    (channels * weights).sum().backward()
    gradients = {name: v.grad.cpu() for name, v in vars(leaves).items()}
    gradients["pose"] = tangent(camera(), pose.grad.double())
    gradients["means2d"] = image.meta.means2d_grad.cpu()
    if image.meta.means2d_absgrad is not None:
        gradients["means2d_abs"] = image.meta.means2d_absgrad.cpu()
    if background is not None:
        gradients["background"] = extra["background"].grad
    meta = RasterMeta(
        **{name: v if v is None else v.detach().cpu() for name, v in vars(image.meta).items()}
    )
    return Outcome(
        Rasterization(image.rgb.cpu(), image.depth.cpu(), image.alpha.cpu(), meta), gradients
    )


def tangent(pose: Tensor, gradient: Tensor) -> Tensor:
    """Gradient (6,) along translations and rotations of the camera frame."""
    parts = []
    for axis in range(6):
        twist = torch.zeros(4, 4, dtype=torch.float64)
        if axis < 3:
            twist[axis, 3] = 1
        else:
            i, j = [(2, 1), (0, 2), (1, 0)][axis - 3]
            twist[i, j], twist[j, i] = 1, -1
        parts.append((gradient * (twist @ pose)).sum())
    return torch.stack(parts)


def relative_error(actual: Tensor, expected: Tensor) -> float:
    """L2 norm of the difference over that of the expected value."""
    expected = expected.double()
    return float((actual.double() - expected).norm() / expected.norm())
