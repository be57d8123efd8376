"""`meta.means2d_absgrad`: what the pixels contribute to the gradient of a centre, in size."""

from __future__ import annotations

import pytest
import torch
from tests.splats.test_native_rasterizer import check

from recast.splats import Gaussians, RasterMeta, native, rasterize
from support.splat_scenes import (
    HEIGHT,
    KINDS,
    WIDTH,
    K,
    camera,
    random_gaussians,
    relative_error,
    render_with_gradients,
)

BACKENDS = ("native", "reference")
SMALL = torch.tensor([[6.0, 0, 4], [0, 6.2, 3], [0, 0, 1]])


@pytest.mark.parametrize("kind", KINDS)
def test_the_kernel_matches_the_reference(isa: str, kind: str) -> None:
    gaussians = random_gaussians(kind, count=300)
    actual = render_with_gradients(gaussians, "native", torch.float32, absgrad=True)
    wanted = render_with_gradients(gaussians, "reference", torch.float64, absgrad=True)
    assert "means2d_abs" in wanted.gradients
    check(actual, wanted, kind)


def test_asking_changes_nothing_else(isa: str) -> None:
    gaussians = random_gaussians("normal")
    plain = render_with_gradients(gaussians, "native", torch.float32)
    asked = render_with_gradients(gaussians, "native", torch.float32, absgrad=True)
    assert plain.image.meta.means2d_absgrad is None
    for name in ("rgb", "depth", "alpha"):
        assert torch.equal(getattr(plain.image, name), getattr(asked.image, name))
    for name, gradient in plain.gradients.items():
        assert torch.equal(gradient, asked.gradients[name]), name


def differentiate(backend: str, weights: torch.Tensor) -> list[RasterMeta]:
    """Meta of views of one scene after a loss each: `weights` (L, 6, 8, 5) of their channels."""
    leaves = random_gaussians("normal", count=8)
    leaves.means[:, :2] *= 0.5
    leaves.means.requires_grad_()
    found = []
    for each in weights:
        image = rasterize(leaves, camera(), SMALL, 8, 6, absgrad=True, backend=backend)
        assert image.meta.means2d_absgrad is None
        channels = [image.rgb, image.depth[..., None], image.alpha[..., None]]
        (torch.cat(channels, dim=-1) * each).sum().backward()
        found.append(image.meta)
    return found


@pytest.fixture
def weights() -> torch.Tensor:
    return torch.randn(6, 8, 5, generator=torch.Generator().manual_seed(2))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.usefixtures("compiled")
def test_it_is_the_sum_over_pixels_of_each_ones_own(backend: str, weights: torch.Tensor) -> None:
    pixels = torch.eye(48).reshape(-1, 6, 8, 1) * weights
    (all_at_once,) = differentiate(backend, weights[None])
    one_by_one = differentiate(backend, pixels)
    total = torch.zeros_like(all_at_once.means2d)
    for meta in one_by_one:
        # A single pixel has nothing to cancel.
        assert torch.allclose(meta.means2d_absgrad, meta.means2d_grad.abs(), rtol=1e-4, atol=1e-6)
        total += meta.means2d_grad.abs()
    assert relative_error(all_at_once.means2d_absgrad, total) < 1e-5
    assert (all_at_once.means2d_grad.abs() <= 1.0001 * all_at_once.means2d_absgrad + 1e-6).all()
    assert float(all_at_once.means2d_grad.norm() / total.norm()) < 0.7  # others did cancel


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.usefixtures("compiled")
def test_a_second_backward_pass_does_not_add_to_the_first(backend: str) -> None:
    gaussians = random_gaussians("normal", count=50)
    gaussians.means.requires_grad_()
    image = rasterize(gaussians, camera(), K, WIDTH, HEIGHT, absgrad=True, backend=backend)
    image.rgb.sum().backward(retain_graph=True)
    first = image.meta.means2d_absgrad.clone()
    image.rgb.sum().backward()
    assert torch.equal(image.meta.means2d_absgrad, first)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.usefixtures("compiled")
def test_rows_out_of_view_have_none(backend: str) -> None:
    gaussians = random_gaussians("normal", count=60)
    gaussians.means[::2, 2] -= 50
    nothing = gaussians.select(torch.zeros(0, dtype=torch.int64))
    for part in (gaussians, nothing):
        leaves = Gaussians(**{k: v.clone().requires_grad_() for k, v in vars(part).items()})
        image = rasterize(leaves, camera(), K, WIDTH, HEIGHT, absgrad=True, backend=backend)
        (image.rgb.sum() + image.depth.sum()).backward()
        absolute = image.meta.means2d_absgrad
        assert absolute.shape == (len(part), 2)
        assert not absolute[~image.meta.visible].any()
        assert absolute[image.meta.visible].any() == bool(len(part))


def test_repeats_bit_by_bit_on_any_number_of_threads(isa: str) -> None:
    gaussians = random_gaussians("opaque", count=800)
    threads = native.info().threads
    found = []
    try:
        for count in (1, 2, 3):
            native.set_threads(count)
            outcome = render_with_gradients(gaussians, "native", torch.float32, absgrad=True)
            found.append(outcome.gradients["means2d_abs"])
    finally:
        native.set_threads(threads)
    assert torch.equal(found[0], found[1]) and torch.equal(found[0], found[2])
