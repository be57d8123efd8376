"""The template made from several crops: shape by their outlines, colours of all that they show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from actors.made_up_views import CAMERA, seen_from
from recast.actors import TemplateGenerator
from recast.actors.observe import observation_of_view
from recast.actors.template.design import STYLES
from recast.actors.template.proportions import FITTED, _Problem, contour, fit_shapes
from recast.actors.template.texture import SurfaceView, balanced, blended
from recast.geometry.colour import gamma_to_linear, linear_to_gamma
from recast.scene.actor import look_at
from recast.splats import Gaussians
from support import made_up_actors as made_up

NO_POINTS = np.zeros((0, 3))


def test_the_lines_of_an_outline_graze_the_body() -> None:
    """A ball: its outline is known exactly."""
    camera_from_object = look_at(np.array([5.0, 7.0, 1.0]), np.zeros(3))
    centre, radius = camera_from_object[:3, 3], 0.6
    rays = CAMERA.rays(CAMERA.pixel_grid())
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    inside = np.linalg.norm(np.cross(rays, centre), axis=-1) < radius
    rgba = np.dstack([np.zeros((*inside.shape, 3), np.uint8), inside.astype(np.uint8) * 255])
    seen = observation_of_view(rgba, CAMERA, camera_from_object, made_up.SIZE, name="ball")
    lines = contour(seen)

    def distance(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points - [0.0, 0.0, made_up.SIZE[2] / 2], axis=1) - radius

    here = np.zeros(2)
    found = distance(lines.points(lines.nearest(distance, here), here))
    assert len(found) > 20
    pixel = np.linalg.norm(centre) / CAMERA.fx
    # the outline runs between pixel centres: at most half a pixel's diagonal away
    assert np.abs(found).max() < pixel * np.sqrt(0.5)
    assert abs(found.mean()) < 0.5 * pixel  # as far in as the centres of the mask's own pixels are
    aside = distance(
        lines.points(lines.nearest(distance, np.array([0.3, 0.0])), np.array([0.3, 0]))
    )
    assert aside.max() == pytest.approx(0.3, abs=pixel)


def test_outlines_alone_tell_the_style() -> None:
    """Without LiDAR, of boxes labelled 8 cm off, once to the left and once to the right."""
    vehicle = made_up.car(style="sedan")  # of that size an estate is likelier
    views = [seen_from(vehicle, 120.0, 0.08), seen_from(vehicle, -75.0, -0.08)]
    outlines = [contour(view) for view in views]
    fit = fit_shapes("car", made_up.SIZE, NO_POINTS, np.random.default_rng(0), None, outlines)[0]
    assert fit.style == "sedan"
    assert np.isnan(fit.median_distance)


def test_slopes_are_those_of_the_residuals(red_car: Gaussians) -> None:
    """Where a line comes nearest moves with the shape, and yet need not be followed."""
    points = made_up.lidar_hits(np.random.default_rng(0), np.array([-9.0, 4.0, 1.0]), 100)
    points += np.array([0.0, 0.0, made_up.SIZE[2] / 2])
    outline = contour(seen_from(red_car, 150.0))
    problem = _Problem(STYLES["hatchback"], made_up.SIZE, points, [outline])
    rng = np.random.default_rng(1)
    x = 0.3 * rng.normal(size=len(FITTED) + 3 + 2)
    slopes = problem._slopes(x)
    for direction in rng.normal(size=(3, len(x))):
        step = 0.02 * direction / np.linalg.norm(direction)
        change = problem._residuals(x + step) - problem._residuals(x - step)
        followed = slopes @ (2 * step)
        # some lines jump from one feature to another
        assert np.quantile(np.abs(change - followed), 0.8) < 0.1 * np.quantile(np.abs(change), 0.8)


def view_of(colour: np.ndarray, weight: np.ndarray, sharpness: float = 40.0) -> SurfaceView:
    towards = np.tile([0.0, 1.0, 0.0], (len(weight), 1))
    return SurfaceView(colour, weight, towards, np.full(len(weight), sharpness))


def test_exposure_is_told_by_what_two_views_share() -> None:
    colour = np.random.default_rng(0).uniform(0.2, 0.6, (4000, 3))
    half = np.arange(4000) < 2000
    darker = linear_to_gamma(0.6 * gamma_to_linear(colour))
    first = view_of(colour, (~half | (np.arange(4000) < 1500)).astype(float))
    second = view_of(darker, half.astype(float))
    _, balance = balanced([first, second])
    assert balance.gain == pytest.approx(1 / 0.6, rel=0.05)
    np.testing.assert_allclose(balance.colour[half], colour[half], atol=0.02)
    apart = view_of(darker, np.zeros(4000))
    assert balanced([first, apart])[1].gain == 1.0


def test_each_patch_looks_as_in_the_view_that_shows_it_best() -> None:
    red, blue = np.tile([0.8, 0.1, 0.1], (3, 1)), np.tile([0.1, 0.1, 0.8], (3, 1))
    sharp = view_of(red, np.array([1.0, 0.0, 0.0]), 80.0)
    coarse = view_of(blue, np.array([1.0, 0.6, 0.0]), 30.0)
    seen = blended([sharp, coarse])
    np.testing.assert_allclose(seen.colour[0], red[0], atol=0.05)
    np.testing.assert_allclose(seen.colour[1], blue[1])
    np.testing.assert_allclose(seen.weight, [1.0, 0.6, 0.0])
    assert np.isfinite(seen.colour).all() and np.isfinite(seen.views).all()


def test_one_wrong_view_of_three_counts_little() -> None:
    """A pole before the vehicle in a view no sharper than the others."""
    grey, pole = np.full((1, 3), 0.5), np.full((1, 3), 0.05)
    weight = np.ones(1)
    seen = blended([view_of(grey, weight), view_of(pole, weight), view_of(grey, weight)])
    # the mean would be 0.35
    assert seen.colour[0, 0] > 0.42


@pytest.fixture(scope="module")
def two_coloured(red_car: Gaussians) -> Gaussians:
    """The car with a green front half."""
    sh = red_car.sh.clone()
    sh[red_car.means[:, 0] > 0, 0] = torch.tensor([-1.3, 0.6, -1.3])
    sh[:, 1:] = 0
    return replace(red_car, sh=sh)


def greenness(vehicle: Gaussians, where: torch.Tensor) -> float:
    """Median of green over red of the base colours there, display values."""
    colour = 0.5 + 0.28209479 * vehicle.sh[where, 0]
    return float((colour[:, 1] - colour[:, 0]).median())


def test_a_side_seen_in_any_crop_has_its_colours(two_coloured: Gaussians) -> None:
    generator = TemplateGenerator(spacing=0.08, style="estate")
    behind, ahead = seen_from(two_coloured, 170.0), seen_from(two_coloured, -20.0, level=0.7)
    both = replace(behind, further=(ahead,))
    for observation, front_is_green in ((behind, False), (both, True)):
        vehicle = generator.generate(observation, 0).gaussians
        x, _, z = vehicle.means.T
        body = (z > -0.3) & (z < 0.0)
        assert greenness(vehicle, (x < -2.0) & body) < -0.2
        assert (greenness(vehicle, (x > 2.0) & body) > 0.1) == front_is_green


def test_labels_that_are_off_differently_are_told(red_car: Gaussians) -> None:
    """Both masks are met although their boxes are 16 cm apart: each view has a shift of its own."""
    generator = TemplateGenerator(spacing=0.08, style="estate")
    views = seen_from(red_car, 135.0, 0.08), seen_from(red_car, -45.0, 0.08)
    asset = generator.generate(replace(views[0], further=(views[1],)), 0)
    assert float(asset.details["silhouette_overlap"]) > 0.93
    low, high = asset.gaussians.means.aminmax(dim=0)
    # ... and the asset keeps the size of the box
    mirrors = np.array([0.0, 0.16, 0.0])
    np.testing.assert_allclose(high - low, made_up.SIZE + mirrors, atol=0.06)


def test_the_styles_that_fit_best_are_offered() -> None:
    """Each once, the best one first."""
    generator = TemplateGenerator(spacing=0.3)
    seen = seen_from(made_up.car(style="sedan"), 90.0)
    styles = [make().details["style"] for make in generator.candidates(seen, 0)]
    assert len(set(styles)) == len(styles) == 3
    assert styles[0] == "sedan"


def test_the_best_view_alone_is_offered_too(red_car: Gaussians) -> None:
    generator = TemplateGenerator(spacing=0.15, style="estate")
    seen = replace(seen_from(red_car, 120.0), further=(seen_from(red_car, 30.0),))
    assert [make().details["views"] for make in generator.candidates(seen, 0)] == [2, 1]
    assert len(generator.candidates(replace(seen, further=()), 0)) == 1


def test_the_same_views_make_the_same_bytes(red_car: Gaussians) -> None:
    generator = TemplateGenerator(spacing=0.2, style="estate")
    seen = replace(seen_from(red_car, 120.0), further=(seen_from(red_car, 30.0),))
    first, again = (generator.generate(seen, 3).gaussians for _ in range(2))
    assert first.sh.numpy().tobytes() == again.sh.numpy().tobytes()
    assert first.means.numpy().tobytes() == again.means.numpy().tobytes()
