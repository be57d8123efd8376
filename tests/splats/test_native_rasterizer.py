"""The compiled rasterizer against the torch reference in float64, values and gradients."""

from __future__ import annotations

import gc
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import pytest
import torch

from recast.splats import Gaussians, native, rasterize
from support.splat_scenes import (
    HEIGHT,
    KINDS,
    WIDTH,
    K,
    Outcome,
    camera,
    random_gaussians,
    relative_error,
    render_with_gradients,
)

OPTIONS: dict[str, dict[str, object]] = {
    "classic": {},
    "background": {"background": torch.tensor([0.2, 0.5, 0.9])},
    "antialiased": {"antialiased": True, "eps2d": 0.2},
    "max_alpha": {"max_alpha": 0.999},
    "far": {"far": 5.0, "near": 1.0},
}


@lru_cache
def expected(kind: str, options: str) -> Outcome:
    return render_with_gradients(
        random_gaussians(kind), "reference", torch.float64, **OPTIONS[options]
    )


def check(actual: Outcome, wanted: Outcome, kind: str) -> None:
    # A pixel at the very threshold of alpha may fall on either side: then it is off by 1/255 of one
    # Gaussian's share, and the gradients by as little.
    tolerance = 5e-4 if kind == "needles" else 2e-5
    for name in ("rgb", "depth", "alpha"):
        difference = (getattr(actual.image, name) - getattr(wanted.image, name)).detach().abs()
        assert float(difference.max()) < 3e-3, name
        assert float(difference.mean()) < tolerance / 10, name
    assert torch.equal(actual.image.meta.visible, wanted.image.meta.visible)
    assert torch.allclose(actual.image.meta.means2d, wanted.image.meta.means2d, atol=1e-3)
    for name, gradient in wanted.gradients.items():
        assert relative_error(actual.gradients[name], gradient) < tolerance, name


@pytest.mark.parametrize("kind", KINDS)
def test_matches_reference_on_every_instruction_set(isa: str, kind: str) -> None:
    actual = render_with_gradients(random_gaussians(kind), "native", torch.float32)
    check(actual, expected(kind, "classic"), kind)


@pytest.mark.parametrize("options", [name for name in OPTIONS if name != "classic"])
@pytest.mark.usefixtures("compiled")
def test_matches_reference_with_options(options: str) -> None:
    actual = render_with_gradients(
        random_gaussians("normal"), "native", torch.float32, **OPTIONS[options]
    )
    check(actual, expected("normal", options), "normal")


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_matches_reference_at_lower_degrees(isa: str, degree: int) -> None:
    gaussians = random_gaussians("normal", count=150, degree=degree)
    actual = render_with_gradients(gaussians, "native", torch.float32)
    wanted = render_with_gradients(gaussians, "reference", torch.float64)
    check(actual, wanted, "normal")


def test_large_splats_cover_many_tiles(isa: str) -> None:
    gaussians = random_gaussians("normal", count=60)
    gaussians.log_scales.add_(2.0)
    actual = render_with_gradients(gaussians, "native", torch.float32)
    wanted = render_with_gradients(gaussians, "reference", torch.float64)
    check(actual, wanted, "normal")


def test_deep_stacks_pass_the_batch_size(isa: str) -> None:
    gaussians = random_gaussians("normal", count=1500)
    gaussians.means[:, :2] *= 0.05
    gaussians.logit_opacities.sub_(4.5)  # faint, so that hundreds contribute to a pixel
    actual = render_with_gradients(gaussians, "native", torch.float32)
    wanted = render_with_gradients(gaussians, "reference", torch.float64)
    check(actual, wanted, "normal")


def test_repeats_bit_by_bit_and_on_any_number_of_threads(isa: str) -> None:
    gaussians = random_gaussians("normal", count=3000)
    outcomes = []
    threads = native.info().threads
    try:
        for count in (1, 1, 2, 3):
            native.set_threads(count)
            outcomes.append(render_with_gradients(gaussians, "native", torch.float32))
    finally:
        native.set_threads(threads)
    first = outcomes[0]
    for other in outcomes[1:]:
        assert torch.equal(first.image.rgb, other.image.rgb)
        assert torch.equal(first.image.depth, other.image.depth)
        for name, gradient in first.gradients.items():
            assert torch.equal(gradient, other.gradients[name]), name


@pytest.mark.usefixtures("compiled")
def test_order_of_gaussians_does_not_matter() -> None:
    gaussians = random_gaussians("normal")
    order = torch.randperm(len(gaussians), generator=torch.Generator().manual_seed(1))
    first = render_with_gradients(gaussians, "native", torch.float32)
    second = render_with_gradients(gaussians.select(order), "native", torch.float32)
    assert torch.allclose(first.image.rgb, second.image.rgb, atol=1e-6)
    for name in ("means", "sh"):
        assert relative_error(second.gradients[name], first.gradients[name][order]) < 1e-5


@pytest.mark.usefixtures("compiled")
def test_views_alive_at_once_do_not_disturb_each_other() -> None:
    gaussians = random_gaussians("normal", count=200)
    leaves = Gaussians(**{k: v.clone().requires_grad_() for k, v in vars(gaussians).items()})
    alone = rasterize(leaves, camera(), K, WIDTH, HEIGHT, backend="native")
    alone.rgb.sum().backward()
    wanted = leaves.means.grad.clone()
    leaves.means.grad = None
    first = rasterize(leaves, camera(), K, WIDTH, HEIGHT, backend="native")
    kept = first.rgb.detach().clone()
    moved = camera()
    moved[0, 3] += 0.5
    second = rasterize(leaves, moved, K, WIDTH // 2, HEIGHT, backend="native")
    assert torch.equal(first.rgb, kept)
    (second.rgb.sum() * 0 + first.rgb.sum()).backward()
    assert torch.equal(leaves.means.grad, wanted)


@pytest.mark.usefixtures("compiled")
def test_python_threads_at_once() -> None:
    kinds = KINDS * 3
    wanted = {
        kind: render_with_gradients(random_gaussians(kind), "native", torch.float32)
        for kind in KINDS
    }
    with ThreadPoolExecutor(3) as threads:
        outcomes = threads.map(
            lambda kind: render_with_gradients(random_gaussians(kind), "native", torch.float32),
            kinds,
        )
        for kind, outcome in zip(kinds, outcomes, strict=True):
            assert torch.equal(outcome.image.rgb, wanted[kind].image.rgb)
            assert torch.equal(outcome.gradients["means"], wanted[kind].gradients["means"])


@pytest.mark.usefixtures("compiled")
def test_second_backward_through_a_retained_graph() -> None:
    leaf = random_gaussians("normal", count=200)
    leaf.means.requires_grad_()
    image = rasterize(leaf, camera(), K, WIDTH, HEIGHT, backend="native").rgb.sum()
    (first,) = torch.autograd.grad(image, leaf.means, retain_graph=True)
    first = first.clone()
    (second,) = torch.autograd.grad(image, leaf.means)
    assert torch.equal(first, second)


@pytest.mark.usefixtures("compiled")
def test_recycled_memory_leaves_results_alone() -> None:
    gaussians = random_gaussians("normal", count=200)
    outcomes = [render_with_gradients(gaussians, "native", torch.float32) for _ in range(2)]
    kept = {name: g.clone() for name, g in outcomes[0].gradients.items()}
    rgb = outcomes[0].image.rgb.detach().clone()
    del outcomes[1]
    gc.collect()
    render_with_gradients(random_gaussians("opaque", count=200), "native", torch.float32)
    assert torch.equal(outcomes[0].image.rgb, rgb)
    for name, gradient in outcomes[0].gradients.items():
        assert torch.equal(gradient, kept[name])


@pytest.mark.usefixtures("compiled")
def test_only_the_pose_learns() -> None:
    gaussians = random_gaussians("normal", count=200)
    pose = camera().requires_grad_()
    rasterize(gaussians, pose, K, WIDTH, HEIGHT, backend="native").depth.sum().backward()
    assert pose.grad is not None
    assert float(pose.grad.abs().max()) > 0
    assert torch.equal(pose.grad[3], torch.zeros(4, dtype=torch.float64))


@pytest.mark.parametrize("backend", ["native", "reference"])
@pytest.mark.usefixtures("compiled")
def test_nothing_to_see(backend: str) -> None:
    background = torch.tensor([0.1, 0.2, 0.3])
    behind = random_gaussians("normal", count=50)
    behind.means[:, 2] -= 100
    none = behind.select(torch.zeros(0, dtype=torch.int64))
    for gaussians in (behind, none):
        gaussians.means.requires_grad_()
        image = rasterize(
            gaussians, camera(), K, WIDTH, HEIGHT, background=background, backend=backend
        )
        assert torch.equal(image.rgb, background.expand(HEIGHT, WIDTH, 3))
        assert not image.alpha.any()
        assert not image.meta.visible.any()
        if backend == "native":
            (image.rgb.sum() + image.depth.sum()).backward()
            assert not gaussians.means.grad.any()


@pytest.mark.usefixtures("compiled")
def test_rows_that_are_not_visible_get_zero_gradients() -> None:
    gaussians = random_gaussians("normal", count=400)
    gaussians.means[::2, 2] -= 50
    outcome = render_with_gradients(gaussians, "native", torch.float32)
    hidden = ~outcome.image.meta.visible
    assert hidden[::2].all()
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh", "means2d"):
        assert not outcome.gradients[name][hidden].any(), name


@pytest.mark.usefixtures("compiled")
def test_a_single_huge_and_a_single_tiny_gaussian() -> None:
    for log_scale in (4.0, -20.0):
        gaussians = random_gaussians("normal", count=1)
        gaussians.means[0] = torch.tensor([0.0, 0.0, 3.0])
        gaussians.log_scales[0] = log_scale
        gaussians.logit_opacities[0] = 6.0
        actual = rasterize(gaussians, camera(), K, WIDTH, HEIGHT, backend="native")
        wanted = rasterize(gaussians, camera(), K, WIDTH, HEIGHT, backend="reference")
        assert torch.allclose(actual.rgb, wanted.rgb, atol=1e-4)
