"""Frozen parts against the rasterizer and the reference on all of them, moved and concatenated."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest
import torch
from torch import Tensor

from recast.splats import (
    CLASSIC,
    MIP,
    FrozenGaussians,
    Gaussians,
    LowPass,
    RasterImages,
    Window,
    concatenate,
    freeze,
    morton_order,
    rasterize,
    rasterize_frozen,
    refiltered,
)
from recast.splats.gaussians import quat_to_matrix
from recast.splats.native import rasterizer
from support.splat_scenes import HEIGHT, KINDS, WIDTH, K, camera, random_gaussians

EYE = torch.eye(4, dtype=torch.float64)
GREY_LEVEL = 1 / 255


def pose(seed: int) -> Tensor:
    """world_from_part (4, 4): any turn, a metre or so aside."""
    generator = torch.Generator().manual_seed(seed)
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :3] = quat_to_matrix(torch.randn(4, generator=generator).double())
    matrix[:3, 3] = torch.randn(3, generator=generator).double()
    return matrix


def scattered(seed: int, count: int = 3000) -> Gaussians:
    """Small Gaussians on all sides of the camera, so that most blocks are out of view."""
    generator = torch.Generator().manual_seed(seed)
    means = 20 * torch.randn(count, 3, generator=generator)
    wide = replace(random_gaussians("normal", count, seed, degree=1), means=means)
    return wide.select(morton_order(means))


def in_halves(gaussians: Gaussians) -> Gaussians:
    """Colours that half precision holds exactly: what is left is rounding."""
    return replace(gaussians, sh=gaussians.sh.half().float())


def draw(parts: list[tuple[FrozenGaussians, Tensor]], **options: object) -> RasterImages:
    return rasterize_frozen(parts, camera(), K, WIDTH, HEIGHT, **options)  # type: ignore[arg-type]


def check_same(actual: RasterImages, wanted: RasterImages) -> None:
    # A pixel at the threshold of alpha may fall on either side: then it is off by 1/255 of a colour
    # or a depth.
    deepest = float(wanted.depth.max())
    for name, size in (("rgb", 1.0), ("depth", deepest), ("alpha", 1.0)):
        difference = (getattr(actual, name) - getattr(wanted, name)).abs()
        assert float(difference.max()) < size / 255, name
        assert float(difference.mean()) < 5e-5 * size, name


@pytest.mark.parametrize("kind", KINDS)
def test_parts_of_any_degree_and_pose_are_what_they_are_together(isa: str, kind: str) -> None:
    still = in_halves(random_gaussians(kind, degree=3))
    moved = {pose(d): in_halves(random_gaussians(kind, 130 + d, d, degree=d)) for d in range(3)}
    together = concatenate([still, *(g.transformed(p) for p, g in moved.items())])
    parts = [(freeze(still), EYE), *((freeze(g), p) for p, g in moved.items())]
    wanted = rasterize(
        Gaussians(*(v.double() for v in vars(together).values())),
        camera(),
        K,
        WIDTH,
        HEIGHT,
        backend="reference",
    )
    check_same(draw(parts), wanted)


@pytest.mark.parametrize("seed", range(6))
def test_culling_leaves_out_nothing_that_is_seen(isa: str, seed: int) -> None:
    gaussians = in_halves(scattered(seed))
    frozen = freeze(gaussians)
    for view in (camera(), pose(seed), pose(seed + 50)):
        actual = rasterize_frozen([(frozen, EYE)], view, K, WIDTH, HEIGHT)
        check_same(actual, rasterize(gaussians, view, K, WIDTH, HEIGHT))
        assert float(actual.alpha.max()) > 0.1


def test_a_block_at_the_border_of_the_image_is_drawn(isa: str) -> None:
    # One Gaussian, its centre ever farther out on each side, until nothing of it is left.
    one = Gaussians(
        torch.zeros(1, 3), torch.tensor([[1.0, 0, 0, 0]]), torch.full((1, 3), -1.0),
        torch.tensor([6.0]), torch.ones(1, 1, 3),
    )  # fmt: skip
    drawn = 0
    for axis in (0, 1):
        for offset in torch.linspace(-4, 4, 81).tolist():
            mean = torch.tensor([[0.0, 0.0, 3.0]])
            mean[0, axis] = offset
            moved = replace(one, means=mean)
            view = torch.eye(4)
            wanted = rasterize(moved, view, K, WIDTH, HEIGHT)
            actual = rasterize_frozen([(freeze(moved), EYE)], view, K, WIDTH, HEIGHT)
            assert torch.allclose(actual.rgb, wanted.rgb, atol=2e-3)
            drawn += bool(wanted.meta.visible.any())
    assert 20 < drawn < 140


def test_images_stay_within_a_grey_level_of_full_precision(isa: str) -> None:
    gaussians = random_gaussians("opaque", degree=3)
    gaussians.sh[:, 0] *= 5
    exact = rasterize(gaussians, camera(), K, WIDTH, HEIGHT).rgb.clamp(0, 1)
    drawn = draw([(freeze(gaussians), EYE)]).rgb.clamp(0, 1)
    assert not torch.equal(drawn, exact)
    assert float((drawn - exact).abs().max()) < GREY_LEVEL


def test_small_and_large_halves_are_read_alike(isa: str) -> None:
    sizes = torch.tensor([6e-8, 1e-6, 6.1e-5, 0.5, 3.0, 1000.0, 65504.0, 1e6])
    gaussians = random_gaussians("normal", 8, degree=0)
    for scale in sizes.tolist():
        sh = torch.full((8, 1, 3), scale)
        held = sh.clamp(max=65504).half().float()
        wanted = rasterize(replace(gaussians, sh=held), camera(), K, WIDTH, HEIGHT).rgb
        actual = draw([(freeze(replace(gaussians, sh=sh)), EYE)]).rgb
        assert torch.allclose(actual, wanted, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    "options",
    [{"background": torch.tensor([0.2, 0.5, 0.9])}, {"far": 5.0, "near": 1.0},
     {"max_alpha": 0.999}],
)  # fmt: skip
@pytest.mark.usefixtures("compiled")
def test_options_are_those_of_the_rasterizer(options: dict[str, object]) -> None:
    gaussians = in_halves(random_gaussians("normal"))
    wanted = rasterize(gaussians, camera(), K, WIDTH, HEIGHT, **options)  # type: ignore[arg-type]
    check_same(draw([(freeze(gaussians), EYE)], **options), wanted)


@pytest.mark.usefixtures("compiled")
def test_an_image_in_bands_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = [(freeze(random_gaussians("opaque")), EYE)]
    whole = draw(parts)
    monkeypatch.setattr(rasterizer, "MOST_AT_ONCE", 500)
    for name, value in vars(draw(parts)).items():
        assert torch.equal(value, getattr(whole, name))


def test_each_part_is_drawn_through_the_filter_that_it_was_made_for(isa: str) -> None:
    gaussians = in_halves(random_gaussians("normal", 300))
    far = gaussians.select(gaussians.means[:, 2] > 3)
    empty = gaussians.select(torch.zeros(0, dtype=torch.int64))
    for low_pass in (CLASSIC, MIP, LowPass(1.5), LowPass(0.8, antialiased=True)):
        wanted = rasterize(
            far, camera(), K, WIDTH, HEIGHT,
            eps2d=low_pass.variance, antialiased=low_pass.antialiased,
        )  # fmt: skip
        for other in (CLASSIC, MIP):
            parts = [(freeze(empty, other), EYE), (freeze(far, low_pass), EYE)]
            check_same(draw(parts), wanted)


def test_elsewhere_parts_are_refiltered_for_the_filter_of_the_first() -> None:
    gaussians = random_gaussians("normal", 100)
    parts = [(freeze(gaussians), EYE), (freeze(gaussians, MIP), pose(1))]
    view = camera().float()
    posed = refiltered(gaussians.transformed(pose(1)), MIP, CLASSIC, view, K)
    wanted = rasterize(concatenate([gaussians, posed]), view, K, WIDTH, HEIGHT, backend="reference")
    assert torch.equal(draw(parts, backend="reference").rgb, wanted.rgb)


def test_other_colours_are_those_of_freezing_anew(isa: str) -> None:
    gaussians = random_gaussians("normal", 300, degree=1)
    others = replace(gaussians, sh=gaussians.sh.flip(0))
    drawn = draw([(freeze(gaussians, MIP).recoloured(others.sh), EYE)])
    assert torch.equal(drawn.rgb, draw([(freeze(others, MIP), EYE)]).rgb)
    for sh in (others.sh[1:], others.sh * float("nan")):
        with pytest.raises(ValueError, match="sh"):
            freeze(gaussians).recoloured(sh)


def test_the_reference_draws_parts_too() -> None:
    gaussians = random_gaussians("normal", 100)
    parts = [(freeze(gaussians), EYE), (freeze(gaussians), pose(1))]
    together = concatenate([gaussians, gaussians.transformed(pose(1))])
    wanted = rasterize(together, camera().float(), K, WIDTH, HEIGHT, backend="reference")
    assert torch.equal(draw(parts, backend="reference").rgb, wanted.rgb)


def test_a_part_without_gaussians_is_empty(isa: str) -> None:
    empty = freeze(random_gaussians("normal", 1).select(torch.zeros(0, dtype=torch.int64)))
    assert not draw([(empty, EYE)]).alpha.any()
    one = freeze(random_gaussians("normal"))
    assert torch.equal(draw([(empty, EYE), (one, EYE)]).rgb, draw([(one, EYE)]).rgb)


def test_faults_are_named() -> None:
    gaussians = random_gaussians("normal", 5)
    gaussians.means[3, 1] = float("nan")
    with pytest.raises(ValueError, match=r"means: row 3"):
        freeze(gaussians)
    with pytest.raises(ValueError, match="no part"):
        draw([])
    part = freeze(random_gaussians("normal", 5))
    with pytest.raises(ValueError, match=r"rigid"):
        draw([(part, 2 * EYE)])
    with pytest.raises(ValueError, match=r"camera_from_world is not finite"):
        rasterize_frozen([(part, EYE)], EYE * float("nan"), K, WIDTH, HEIGHT)


@pytest.mark.parametrize("window", [(3, 5, WIDTH - 1, HEIGHT), (16, 16, 32, 32), (21, 7, 23, 9)])
def test_a_window_has_the_pixels_of_the_whole_image(isa: str, window: Window) -> None:
    gaussians = random_gaussians("normal")
    left, top, right, bottom = window
    parts = [(freeze(gaussians), EYE)]
    pairs = [(draw(parts), draw(parts, window=window))]
    for backend in ("native", "reference"):
        render = partial(rasterize, gaussians, camera(), K, WIDTH, HEIGHT, backend=backend)  # type: ignore[arg-type]
        pairs.append((render(), render(window=window)))
    for (whole, part), tolerance in zip(pairs, (0.0, 0.0, 1e-5), strict=True):
        for name in ("rgb", "depth", "alpha"):
            expected = getattr(whole, name)[top:bottom, left:right]
            torch.testing.assert_close(getattr(part, name), expected, rtol=0, atol=tolerance)


def test_gradients_of_a_window_are_those_of_a_loss_on_it(isa: str) -> None:
    left, top, right, bottom = window = (3, 5, WIDTH - 4, HEIGHT - 3)
    gradients = []
    for given in (None, window):
        gaussians = random_gaussians("normal")
        means = gaussians.means.requires_grad_()
        drawn = rasterize(gaussians, camera(), K, WIDTH, HEIGHT, window=given, backend="native")
        rgb = drawn.rgb if given else drawn.rgb[top:bottom, left:right]
        rgb.square().sum().backward()
        gradients.append(means.grad)
    torch.testing.assert_close(gradients[1], gradients[0], rtol=1e-4, atol=1e-4)
    with pytest.raises(ValueError, match="window"):
        rasterize(gaussians, camera(), K, WIDTH, HEIGHT, window=(0, 0, WIDTH + 1, 3))
