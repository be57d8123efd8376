"""The torch reference against finite differences and against formulas worked out by hand."""

from __future__ import annotations

import math

import pytest
import torch

from recast.splats import Gaussians, rasterize
from recast.splats.gaussians import C0
from support.splat_scenes import HEIGHT, WIDTH, camera, random_gaussians

# The middle of the view is the centre of pixel (44, 31).
CENTRED = torch.tensor([[70.0, 0, 44.5], [0, 72, 31.5], [0, 0, 1]])


def one(logit: float, **change: torch.Tensor) -> Gaussians:
    """One round Gaussian of 0.1 m, 4 m ahead."""
    fields = {
        "means": torch.tensor([[0.0, 0.0, 4.0]]),
        "quats": torch.tensor([[1.0, 0, 0, 0]]),
        "log_scales": torch.full((1, 3), math.log(0.1)),
        "logit_opacities": torch.tensor([logit]),
        "sh": torch.tensor([[[1.0, 0.0, -9.0]]]),
    }
    fields.update(change)
    return Gaussians(**{name: value.double() for name, value in fields.items()})


def test_one_gaussian_by_hand() -> None:
    image = rasterize(one(0.5), torch.eye(4), CENTRED, WIDTH, HEIGHT, backend="reference")
    opacity = 1 / (1 + math.exp(-0.5))
    variance_x = (70 * 0.1 / 4) ** 2 + 0.3
    variance_y = (72 * 0.1 / 4) ** 2 + 0.3
    alpha = opacity * math.exp(-0.5 * (2**2 / variance_x + 1 / variance_y))
    assert float(image.alpha[32, 46]) == pytest.approx(alpha, abs=1e-7)
    assert float(image.depth[32, 46]) == pytest.approx(4 * alpha, abs=1e-7)
    assert image.rgb[32, 46].tolist() == pytest.approx(
        [alpha * (C0 + 0.5), alpha * 0.5, 0.0], abs=1e-7
    )


def test_alpha_below_one_255th_is_skipped() -> None:
    image = rasterize(one(0.0), torch.eye(4), CENTRED, WIDTH, HEIGHT, backend="reference")
    positive = image.alpha[image.alpha > 0]
    assert float(positive.min()) >= 1 / 255
    assert float(positive.min()) < 1.3 / 255
    faint = one(math.log((1 / 256) / (255 / 256)))
    image = rasterize(faint, torch.eye(4), CENTRED, WIDTH, HEIGHT, backend="reference")
    assert not image.alpha.any()


def test_alpha_is_capped() -> None:
    for cap in (0.9, 0.99):
        image = rasterize(
            one(20.0), torch.eye(4), CENTRED, WIDTH, HEIGHT, max_alpha=cap, backend="reference"
        )
        assert float(image.alpha.max()) == pytest.approx(cap)


def test_a_pixel_stops_before_transmittance_1e_4() -> None:
    stack = one(20.0)  # alpha 0.995 each: the second would leave 2.5e-5
    repeated = Gaussians(
        **{name: v.repeat(4, *[1] * (v.ndim - 1)) for name, v in vars(stack).items()}
    )
    repeated.means[:, 2] += torch.arange(4) * 0.001
    image = rasterize(
        repeated, torch.eye(4), CENTRED, WIDTH, HEIGHT, max_alpha=0.995, backend="reference"
    )
    assert float(image.alpha[31, 44]) == pytest.approx(0.995)
    assert float(image.alpha[31, 45]) > 0.996  # lower alpha, more of them


def test_antialiasing_keeps_the_integral() -> None:
    """A Gaussian far smaller than a pixel holds the same light whatever the filter adds."""
    small = one(2.0, log_scales=torch.full((1, 3), math.log(0.02)))
    sums = [
        float(
            rasterize(
                small,
                torch.eye(4),
                4 * CENTRED,
                4 * WIDTH,
                4 * HEIGHT,
                eps2d=eps,
                antialiased=antialiased,
                backend="reference",
            ).alpha.sum()
        )
        for eps, antialiased in ((1e-6, False), (0.3, True), (0.3, False))
    ]
    assert sums[1] == pytest.approx(sums[0], rel=0.15)
    assert sums[2] > 1.1 * sums[0]


def test_near_and_far_planes() -> None:
    for near, far, seen in ((0.2, 1e10, True), (4.1, 1e10, False), (0.2, 3.9, False)):
        image = rasterize(
            one(0.0), torch.eye(4), CENTRED, WIDTH, HEIGHT, near=near, far=far, backend="reference"
        )
        assert bool(image.meta.visible[0]) == seen
        assert bool(image.alpha.any()) == seen


def test_gradients_against_finite_differences() -> None:
    gaussians = random_gaussians("normal", count=12, degree=2)
    gaussians.means[:, :2] *= 0.5
    gaussians.logit_opacities.clamp_(-1, 2)
    fields = {name: v.double().requires_grad_() for name, v in vars(gaussians).items()}
    # Wide and smooth, so that no pixel crosses the threshold within the difference.
    generator = torch.Generator().manual_seed(3)
    weights = torch.randn(12, 16, 5, generator=generator, dtype=torch.float64)
    small = torch.tensor([[12.0, 0, 8], [0, 12, 6], [0, 0, 1]])

    def loss(*values: torch.Tensor) -> torch.Tensor:
        *parts, twist = values
        pose = torch.linalg.matrix_exp(hat(twist)) @ camera()
        image = rasterize(
            Gaussians(*parts), pose, small, 16, 12, antialiased=True, backend="reference"
        )
        channels = [image.rgb, image.depth[..., None], image.alpha[..., None]]
        return (torch.cat(channels, dim=-1) * weights).sum()

    twist = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    inputs = [*fields.values(), twist]
    gradients = torch.autograd.grad(loss(*inputs), inputs)
    step = 1e-6
    for index, gradient in enumerate(gradients):
        direction = torch.randn(gradient.shape, generator=generator, dtype=torch.float64)
        shifted = []
        for sign in (1, -1):
            moved = [value.detach() for value in inputs]
            moved[index] = moved[index] + sign * step * direction
            shifted.append(float(loss(*moved)))
        slope = (shifted[0] - shifted[1]) / (2 * step)
        assert float((gradient * direction).sum()) == pytest.approx(slope, rel=2e-4, abs=1e-5)


def hat(twist: torch.Tensor) -> torch.Tensor:
    """Matrix (4, 4) of a twist (6,), translation first."""
    x, y, z, a, b, c = twist
    zero = torch.zeros_like(x)
    rows = [[zero, -c, b, x], [c, zero, -a, y], [-b, a, zero, z], [zero] * 4]
    return torch.stack([torch.stack(row) for row in rows])
