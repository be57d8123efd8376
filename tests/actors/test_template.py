from __future__ import annotations

import dataclasses
from typing import get_args, get_type_hints

import numpy as np
import pytest
import torch
from scipy.ndimage import binary_erosion

from recast.actors import Asset, Observation, TemplateGenerator, turntable
from recast.actors.actor import Actor
from recast.actors.icp import outer_surface
from recast.actors.template.body import TemplateBody, wheel
from recast.actors.template.cloud import build_cloud, gradient, sample
from recast.actors.template.design import (
    STYLES,
    VehicleDesign,
    candidate_styles,
    likely_design,
    limits,
    sample_design,
    sample_size,
)
from recast.actors.template.lighting import fit_harmonics, sh_basis, shade
from recast.actors.template.materials import BODY_PART, BodyPart, label_body
from recast.actors.template.proportions import fit_shapes
from recast.scene.actor import look_at
from recast.splats import Gaussians, rasterize
from support import made_up_actors as made_up

USUAL = {
    "van": (5.3, 1.9, 2.4),
    "bus": (12.0, 2.55, 3.1),
    "truck": (7.5, 2.5, 3.2),
    "pickup": (5.4, 1.9, 1.85),
    "suv": (4.55, 1.85, 1.7),
}


@pytest.mark.parametrize("style", STYLES)
def test_every_style_fills_its_box(style: str) -> None:
    size = np.array(USUAL.get(style, (4.3, 1.75, 1.5)))
    body = TemplateBody(size, STYLES[style])
    points, normals = sample(
        body.distance,
        np.array([-size[0] / 2 - 0.05, 0, 0]),
        np.array([size[0] / 2 + 0.05, size[1] / 2 + 0.05, size[2] + 0.05]),
        0.06,
        np.random.default_rng(0),
    )
    assert np.all(np.abs(points[:, :2]).max(axis=0) <= size[:2] / 2 + 1e-2)
    assert points[:, 0].max() == pytest.approx(size[0] / 2, abs=0.04)
    assert points[:, 0].min() == pytest.approx(-size[0] / 2, abs=0.04)
    assert points[:, 1].max() == pytest.approx(size[1] / 2, abs=0.04)
    assert points[:, 2].max() == pytest.approx(size[2], abs=0.04)
    assert 0.05 < points[:, 2].min() < 0.5
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    labels = label_body(body, points, normals)
    glass = points[BODY_PART[labels] == BodyPart.GLASS]
    assert len(glass) > 0.02 * len(points)
    assert glass[:, 2].min() > 0.3 * size[2]


def half_cloud(body: TemplateBody, spacing: float = 0.04) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of a body's left half; of a long one, 1.3 metres at each end."""
    halves = []
    end = body.length / 2 + 0.05
    start = end - 1.35 if body.length > 6 else 0.0
    for low, high in ((-end, -start), (start, end)):
        near, far = np.array([low, 0.0, 0.0]), np.array([high, body.width / 2 + 0.05, 9.0])
        far[2] = body.height + 0.05
        halves.append(sample(body.distance, near, far, spacing, np.random.default_rng(0)))
    return np.concatenate([one[0] for one in halves]), np.concatenate([one[1] for one in halves])


SAMPLED = [(style, seed) for style in STYLES for seed in range(3)]


@pytest.mark.parametrize(("style", "seed"), SAMPLED)
def test_sampled_designs_are_whole_vehicles(style: str, seed: int) -> None:
    """The box is touched, wheels stand on the ground, and every part is where it belongs."""
    rng = np.random.default_rng(seed)
    size = sample_size(style, rng)
    body = TemplateBody(size, sample_design(style, size, rng))
    points, normals = half_cloud(body, 0.05)
    assert np.isfinite(normals).all()
    assert points[:, 0].max() == pytest.approx(size[0] / 2, abs=0.05)
    assert points[:, 0].min() == pytest.approx(-size[0] / 2, abs=0.05)
    assert points[:, 1].max() == pytest.approx(size[1] / 2, abs=0.05)
    assert points[:, 2].max() == pytest.approx(size[2], abs=0.05)
    for axle in body.axles:
        assert wheel(body, axle, 0.05)[0][:, 2].min() == pytest.approx(0.0, abs=0.01)
        assert abs(axle) + body.arch_radius < size[0] / 2
    # lamps and plates are fine: look at them more closely
    offset = rng.normal(0.0, 0.03, (8, *points.shape))
    points = (points + offset - np.sum(offset * normals, -1, keepdims=True) * normals).reshape(
        -1, 3
    )
    normals = np.tile(normals, (8, 1))
    part = BODY_PART[label_body(body, points, normals)]
    x, y, z = points.T
    front, side = x > 0.3 * size[0], np.abs(normals[:, 1]) > 0.7

    def among(which: BodyPart, where: np.ndarray) -> int:
        return int(np.sum((part == which) & where))

    assert among(BodyPart.HEAD_LAMP, front) > 30
    assert among(BodyPart.HEAD_LAMP, ~front) == 0
    assert y[part == BodyPart.HEAD_LAMP].min() > 0.1 * size[1]
    assert among(BodyPart.TAIL_LAMP, x < -0.3 * size[0]) > 20
    assert among(BodyPart.TAIL_LAMP, x > -0.3 * size[0]) == 0
    for end in (front, x < -0.3 * size[0]):
        assert among(BodyPart.PLATE, end) > 10
        assert z[(part == BodyPart.PLATE) & end].max() < 0.7 * size[2]
    assert among(BodyPart.GLASS, side & (x > 0 if style != "coupe" else x > -0.3)) > 50
    assert among(BodyPart.GLASS, (normals[:, 0] > 0.4) & (x > 0)) > 50
    assert z[part == BodyPart.GLASS].min() > 0.25 * size[2]
    assert among(BodyPart.PAINT, side) > 300


def test_sides_are_alike_but_for_plates_and_fittings() -> None:
    """The exhaust pipe, wipers and the plate's characters are not symmetric."""
    rng = np.random.default_rng(3)
    for style in ("suv", "one-box", "coupe"):
        body = TemplateBody(np.array([4.5, 1.8, 1.6]), sample_design(style, (4.5, 1.8, 1.6), rng))
        points, normals = half_cloud(body)
        left = BODY_PART[label_body(body, points, normals)]
        right = BODY_PART[label_body(body, points * [1, -1, 1], normals * [1, -1, 1])]
        assert np.mean(left != right) < 0.01
        for part in (BodyPart.HEAD_LAMP, BodyPart.TAIL_LAMP, BodyPart.GRILLE):
            np.testing.assert_array_equal(left == part, right == part)


def test_numbers_of_a_design_are_within_their_limits() -> None:
    rng = np.random.default_rng(0)
    for style in STYLES:
        size = sample_size(style, rng)
        for design in (
            likely_design(style, size),
            *(sample_design(style, size, rng) for _ in "ab"),
        ):
            for field in dataclasses.fields(VehicleDesign):
                part = getattr(design, field.name)
                for name, (low, high) in limits(type(part)).items():
                    assert low <= getattr(part, name) <= high, (style, name)
        assert likely_design(style, size) == likely_design(style, size)


def test_every_choice_occurs_and_shows() -> None:
    """A sampler that never takes a choice, or a choice that changes nothing, is useless."""
    rng = np.random.default_rng(0)
    size = np.array([4.4, 1.8, 1.6])
    sampled = [sample_design(style, size, rng) for _ in range(15) for style in STYLES]
    usual = likely_design("suv", size)
    points, normals = half_cloud(TemplateBody(size, usual), 0.035)
    points, normals = np.concatenate([points, points * [1, -1, 1]]), np.tile(normals, (2, 1))
    normals[len(normals) // 2 :, 1] *= -1
    for group in ("front", "rear", "side"):
        for name, hint in get_type_hints(type(getattr(usual, group))).items():
            options = (False, True) if hint is bool else get_args(hint)
            drawn = {getattr(getattr(one, group), name) for one in sampled}
            if options:
                assert drawn == set(options), name
            looks = set()
            for option in options:
                part = dataclasses.replace(getattr(usual, group), **{name: option})
                # parts that others depend on
                if name == "amber":
                    part = dataclasses.replace(part, lamp="almond")
                design = dataclasses.replace(usual, **{group: part})
                looks.add(label_body(TemplateBody(size, design), points, normals).tobytes())
            assert len(looks) == len(options), name


def test_distance_is_signed_and_metric() -> None:
    body = TemplateBody(made_up.SIZE, STYLES["sedan"])
    middle = np.array([[0.0, 0.0, 0.6], [0.0, 0.0, 1.65], [2.4, 0.0, 0.5]])
    inside, above, ahead = body.distance(middle)
    assert inside < -0.2
    assert above == pytest.approx(1.65 - made_up.SIZE[2], abs=0.05)
    assert ahead == pytest.approx(2.4 - made_up.SIZE[0] / 2, abs=0.05)
    points, _ = sample(
        body.distance,
        np.array([-2.3, 0, 0]),
        np.array([2.3, 0.9, 1.5]),
        0.08,
        np.random.default_rng(0),
    )
    slope = np.linalg.norm(gradient(body.distance, points, body.distance(points)), axis=1)
    assert 0.8 < np.median(slope) < 1.2


def test_wheels_stand_on_the_floor(asset: Asset) -> None:
    surface = outer_surface(asset.gaussians)
    lowest = surface.points[surface.points[:, 2] < surface.points[:, 2].min() + 0.03]
    assert lowest[:, 2].min() == pytest.approx(-made_up.SIZE[2] / 2, abs=0.01)
    for sign_x in (-1, 1):
        for sign_y in (-1, 1):
            assert np.any((lowest[:, 0] * sign_x > 0.8) & (lowest[:, 1] * sign_y > 0.5))


def test_cloud_is_symmetric() -> None:
    cloud = build_cloud(TemplateBody(made_up.SIZE, STYLES["suv"]), 0.06, np.random.default_rng(0))
    np.testing.assert_array_equal(cloud.points[cloud.twin], cloud.points * [1, -1, 1])
    np.testing.assert_array_equal(cloud.twin[cloud.twin], np.arange(len(cloud.points)))


def test_same_seed_same_bytes(observation: Observation) -> None:
    generator = TemplateGenerator(spacing=0.15, style="estate")
    first, again = generator.generate(observation, 3), generator.generate(observation, 3)
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        a, b = getattr(first.gaussians, name), getattr(again.gaussians, name)
        assert a.numpy().tobytes() == b.numpy().tobytes()
    assert first.details == again.details


def test_finds_style_paint_and_place(asset: Asset) -> None:
    assert asset.details["style"] == "estate"
    paint = np.array([float(v) for v in str(asset.details["paint_srgb"]).split()])
    np.testing.assert_allclose(paint, made_up.RED, atol=0.07)
    assert float(asset.details["silhouette_overlap"]) > 0.95


def test_fit_follows_the_points() -> None:
    rng = np.random.default_rng(0)
    size = np.array([4.2, 1.75, 1.62])
    truth = TemplateBody(size, STYLES["mpv"])
    points, _ = sample(truth.distance, np.array([-2.2, 0, 0]), np.array([0.5, 0.9, 1.7]), 0.06, rng)
    shifted = points + np.array([0.08, -0.05, -size[2] / 2])
    fit = fit_shapes("car", size, shifted, rng)[0]
    assert fit.style in ("mpv", "hatchback")
    assert fit.median_distance < 0.03
    np.testing.assert_allclose(fit.offset, [0.08, -0.05], atol=0.05)


def test_no_points_take_the_usual_shape() -> None:
    fit = fit_shapes("car", made_up.SIZE, np.zeros((0, 3)), np.random.default_rng(0))[0]
    assert fit.style == "estate"
    assert np.isnan(fit.median_distance)


def test_classes_have_their_styles() -> None:
    assert list(candidate_styles("van", USUAL["van"])) == ["van"]
    assert min(candidate_styles("car", (4.0, 1.70, 1.65)).items(), key=lambda i: i[1])[0] == "mpv"


def silhouette_alpha(gaussians: Gaussians, camera_from_object: np.ndarray) -> np.ndarray:
    matrix = np.array([[400.0, 0, 200], [0, 400, 120], [0, 0, 1]])
    with torch.no_grad():
        picture = rasterize(
            gaussians,
            torch.from_numpy(camera_from_object).float(),
            torch.from_numpy(matrix).float(),
            400,
            240,
        )
    return picture.alpha.numpy()


def test_no_holes_from_any_side(asset: Asset) -> None:
    for azimuth in np.arange(8) * np.pi / 4:
        eye = 8.0 * np.array([np.cos(azimuth), np.sin(azimuth), 0.15])
        alpha = silhouette_alpha(asset.gaussians, look_at(eye, np.zeros(3)))
        core = binary_erosion(alpha > 0.5, iterations=4)
        assert core.sum() > 4000
        assert np.mean(alpha[core] > 0.97) > 0.995


def test_front_has_lamps_screen_and_plate(actor: Actor) -> None:
    """Seen from ahead, which no camera was: bright lamps left and right, plate between them."""
    image = turntable(actor, views=8, width=320, height=180, with_shadow=False)[0].astype(float)
    grey = np.array([0.55, 0.56, 0.58]) * 255
    mask = np.abs(image - grey).max(axis=2) > 25
    rows, columns = np.nonzero(mask)
    top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
    height, width = bottom - top, right - left
    car = image[top:bottom, left:right]
    brightness = car.mean(axis=2)
    red = car[..., 0] - car[..., 1:].max(axis=2)

    def patch(values: np.ndarray, x0: float, x1: float, y0: float, y1: float) -> np.ndarray:
        return values[int(y0 * height) : int(y1 * height), int(x0 * width) : int(x1 * width)]

    for x0, x1 in ((0.1, 0.35), (0.65, 0.9)):
        assert patch(brightness, x0, x1, 0.5, 0.85).max() > 150
    assert np.median(patch(red, 0.4, 0.6, 0.12, 0.32)) < 25  # windscreen: not red
    assert np.median(patch(red, 0.35, 0.65, 0.45, 0.58)) > 60  # bonnet: red
    # left and right look alike
    assert abs(patch(brightness, 0, 0.5, 0, 1).mean() - patch(brightness, 0.5, 1, 0, 1).mean()) < 12


def test_harmonics_follow_the_lit_model() -> None:
    rng = np.random.default_rng(0)
    normals = np.array([[0, 0, 1.0], [1.0, 0, 0], [0.6, 0, 0.8]])
    albedo, gloss = rng.uniform(0.02, 0.5, (3, 3)), np.ones(3)
    sh = fit_harmonics(albedo, gloss, normals, np.ones(3))
    for i, normal in enumerate(normals):
        view = normal + np.array([0.3, 0.1, 0.2])
        view /= np.linalg.norm(view)
        fitted = 0.5 + sh_basis(-view) @ sh[i]
        wanted = shade(albedo[i : i + 1], gloss[:1], normals[i : i + 1], np.ones(1), view[None])[0]
        np.testing.assert_allclose(fitted, wanted, atol=0.12)
