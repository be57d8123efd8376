"""From a mesh file to an asset."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import recast.actors.mesh_generator as making
from recast.actors import MeshGenerator, Observation, register
from recast.actors.mesh_generator import Outside, outside, sample, surfels
from recast.actors.mesh_gltf import Glow, MeshMaterial, Triangles
from recast.actors.template.lighting import CLEAR_DAY
from recast.core.errors import InputError
from recast.geometry.colour import linear_to_gamma
from recast.logs import DrivingLog
from recast.splats import MIP, Gaussians, rasterize
from recast.splats.gaussians import C0
from support.mesh_files import CAR, HALVES, SQUARE, Glb, box, car


def of_box(
    low: object, high: object, colour: tuple[float, ...], flipped: bool = False
) -> Triangles:
    corners, faces = box(low, high)
    triangles = corners.astype(np.float64)[faces[:, ::-1] if flipped else faces]
    alpha = "BLEND" if colour[3] < 1 else "OPAQUE"
    return Triangles(triangles, None, None, MeshMaterial(np.array(colour), alpha=alpha))


def colours(gaussians: Gaussians) -> np.ndarray:
    return 0.5 + C0 * gaussians.sh[:, 0].numpy()


def picture_from_above(gaussians: Gaussians, pixels: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Colours and alpha of the middle, seen from 10 m above, a pixel a centimetre."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 10.0
    camera = torch.tensor([[1000.0, 0, pixels / 2], [0, 1000.0, pixels / 2], [0, 0, 1]])
    picture = rasterize(
        gaussians,
        torch.from_numpy(pose).float(),
        camera,
        pixels,
        pixels,
        eps2d=MIP.variance,
        antialiased=MIP.antialiased,
    )
    return picture.rgb.numpy(), picture.alpha.numpy()


def alpha_through(gaussians: Gaussians) -> np.ndarray:
    return picture_from_above(gaussians)[1]


@pytest.mark.parametrize("alpha", [0.1, 0.35, 0.6, 0.9])
def test_a_pane_lets_through_what_its_alpha_says(alpha: float) -> None:
    """Two faces are one layer. The rasterizer leaves out tails below 1/255, here two or three."""
    pane = of_box([-0.4, -0.4, 0], [0.4, 0.4, 0.004], (0.5, 0.5, 0.5, alpha))
    body = of_box([-0.4, -0.4, -3.6], [0.4, 0.4, -3.56], (0.5, 0.5, 0.5, 1.0))
    samples, _ = sample([pane, body], 0.01)
    seen = outside(samples)
    glass = seen.samples.alpha < 1
    pane_alone = Outside(seen.samples.select(glass), seen.closed[glass])
    drawn = alpha_through(surfels(pane_alone, CLEAR_DAY))
    assert float(drawn.min()) == pytest.approx(alpha, abs=0.02 + 0.02 * alpha)
    assert float(drawn.max()) == pytest.approx(alpha, abs=0.02 + 0.02 * alpha)


def test_what_is_opaque_has_no_holes() -> None:
    samples, _ = sample([of_box([-0.4, -0.4, -0.4], [0.4, 0.4, 0], (0.5, 0.5, 0.5, 1.0))], 0.01)
    assert alpha_through(surfels(outside(samples), CLEAR_DAY)).min() > 0.97


def test_how_the_file_winds_its_triangles_does_not_matter() -> None:
    made = []
    for flipped in (False, True):
        samples, _ = sample([of_box([0, 0, 0], [2, 1, 1], (0.5, 0.1, 0.1, 1.0), flipped)], 0.02)
        made.append(outside(samples).samples)
    for one in made:  # at an edge, both sides of a face are seen: 1.5 cells of 3.6 cm
        edges = np.sort(np.minimum(one.points, [2, 1, 1] - one.points), axis=1)[:, 1]
        away = edges > 0.06
        outwards = np.sum(one.normals * (one.points - [1, 0.5, 0.5]), axis=1)
        assert outwards[away].min() > 0


def test_what_is_inside_is_left_out_unless_glass_shows_it() -> None:
    engine = of_box([0.9, 0.4, 0.4], [1.1, 0.6, 0.6], (0.0, 1.0, 0.0, 1.0))
    for alpha, kept in ((1.0, False), (0.3, True)):
        shell = of_box([0, 0, 0], [2, 1, 1], (1.0, 0.0, 0.0, alpha))
        base = of_box([0, 0, -0.1], [2, 1, -0.05], (1.0, 0.0, 0.0, 1.0))
        samples = outside(sample([engine, shell, base], 0.02)[0]).samples
        assert bool((samples.albedo[:, 1] > 0.2).any()) is kept


def test_a_noisy_texture_does_not_make_a_gaussian_of_every_texel(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    samples, _ = sample([of_box([0, 0, 0], [1, 1, 1], (1.0, 1.0, 1.0, 1.0))], 0.02)
    noise = np.random.default_rng(0).normal(0.5, 0.05, samples.albedo.shape)
    vehicle = outside(replace(samples, albedo=noise))
    many = len(surfels(vehicle, CLEAR_DAY))
    monkeypatch.setattr(making, "MOST_GAUSSIANS", many // 2)
    assert len(surfels(vehicle, CLEAR_DAY)) <= many // 2


def open_box() -> list[Triangles]:
    """White walls a millimetre thin, and a lid of glass."""
    white = MeshMaterial(np.ones(4))
    corners, faces = box([-0.5, -0.5, -0.5], [0.5, 0.5, 0])
    walls = np.array([f for f in faces if corners[f][:, 2].min() < 0])
    lid = of_box([-0.5, -0.5, 0], [0.5, 0.5, 0.01], (1.0, 1.0, 1.0, 0.1))
    return [Triangles(corners[walls].astype(np.float64), None, None, white), lid]


def test_it_is_dark_inside() -> None:
    """Seen through the lid from above, the floor is not the white of its underside."""
    made = surfels(outside(sample(open_box(), 0.01)[0]), CLEAR_DAY)
    rgb, alpha = picture_from_above(made)
    assert alpha.min() > 0.9
    assert rgb.mean() < 0.5


def test_a_mirror_has_no_inside() -> None:
    plate = of_box([3, -0.2, 0], [3.02, 0.2, 0.4], (1.0, 0.0, 0.0, 1.0))
    body = of_box([-2, -1, 0], [2, 1, 1], (0.3, 0.3, 0.3, 1.0))
    seen = outside(sample([plate, body], 0.01)[0])
    of_plate = seen.samples.points[:, 0] > 2.5
    assert not seen.closed[of_plate].any()
    middle = np.abs(seen.samples.points[:, 1]) < 0.8
    assert seen.closed[~of_plate & middle].mean() > 0.9


def test_the_top_is_lighter_than_the_flank() -> None:
    samples, _ = sample([of_box([-2, -1, 0], [2, 1, 1], (0.3, 0.3, 0.3, 1.0))], 0.02)
    made = surfels(outside(samples), CLEAR_DAY)
    up = made.means[:, 2] > 0.995
    flank = (made.means[:, 1].abs() > 0.995) & (made.means[:, 2] < 0.5)
    assert colours(made)[up].mean() > colours(made)[flank].mean() + 0.05


def test_unlit_surfaces_keep_their_colour_and_emission_is_added() -> None:
    """Display values: an unlit box is of one colour; emission shows where nothing is reflected."""
    unlit = MeshMaterial(np.array([0.5, 0.2, 0.1, 1.0]), lit=False)
    box_ = of_box([-2, -1, 0], [2, 1, 1], (0.0, 0.0, 0.0, 1.0))
    made = surfels(outside(sample([replace(box_, material=unlit)], 0.05)[0]), CLEAR_DAY)
    shown = linear_to_gamma(np.array([0.5, 0.2, 0.1]))
    np.testing.assert_allclose(colours(made), np.tile(shown, (len(made), 1)), atol=1e-3)
    assert made.sh[:, 1:].abs().max() < 1e-3
    glowing = replace(box_, glow=Glow(np.array([0.5, 0.2, 0.1])))
    made = surfels(outside(sample([glowing], 0.05)[0]), CLEAR_DAY)
    np.testing.assert_allclose(colours(made), np.tile(shown, (len(made), 1)), atol=1e-3)


@pytest.mark.parametrize("scale", [1.0, 0.01, 39.37])
def test_a_car_stands_up_at_any_scale(
    observation: Observation, tmp_path: Path, scale: float
) -> None:
    glb = car()
    glb.tree["nodes"][0]["scale"] = [scale] * 3
    asset = MeshGenerator(glb.write(tmp_path / "car.glb"), spacing=0.03).generate(observation, 0)
    assert asset.axes.up == "+y"
    assert "inferred from the shape" in str(asset.details["axes"])
    extent = np.ptp(asset.gaussians.means.numpy(), axis=0)[[2, 0, 1]]
    np.testing.assert_allclose(extent, CAR / CAR[0] * observation.size[0], rtol=0.02)
    unit = float(observation.size[0]) / 4.0 / scale
    assert f"{unit:.4g} m a unit" in str(asset.details["scale"])
    assert asset.low_pass == MIP
    asset.gaussians.validate()


def test_the_same_file_gives_the_same_asset(observation: Observation, tmp_path: Path) -> None:
    path = car().write(tmp_path / "car.glb")
    first, second = (MeshGenerator(path, "y-up", 0.05).generate(observation, s) for s in (0, 1))
    assert torch.equal(first.gaussians.means, second.gaussians.means)
    assert torch.equal(first.gaussians.sh, second.gaussians.sh)


def test_it_is_registered_like_any_other(
    observation: Observation, street: DrivingLog, tmp_path: Path
) -> None:
    path = car(glass=1.0).write(tmp_path / "car.glb")
    asset = MeshGenerator(path, "z,y", 0.03).generate(observation, 0)
    assert asset.axes.declares_front
    actor = register(asset, observation, street, street.tracks["7"])
    low, high = np.quantile(actor.gaussians.means.numpy(), [0.0, 1.0], axis=0)
    assert low[2] == pytest.approx(-actor.size[2] / 2, abs=0.02)
    assert high[0] - low[0] == pytest.approx(actor.size[0], rel=0.1)
    assert actor.provenance.details["file"] == "car.glb"


def test_bad_meshes(observation: Observation, tmp_path: Path) -> None:
    flat = Glb()
    flat.primitive(SQUARE, HALVES)
    glass = car(glass=0.3)
    for material in glass.tree["materials"]:
        material["alphaMode"] = "BLEND"
        material["pbrMetallicRoughness"]["baseColorFactor"][3] = 0.3
    block = Glb()
    corners, faces = box([0, 0, 0], [4, 4, 4])
    block.primitive(corners, faces)
    point = Glb()
    point.primitive(np.zeros((3, 3), np.float32), None)
    for glb, named in (
        (flat, "plane"),
        (glass, "opaque points"),
        (block, "axes"),
        (point, "opaque points"),
    ):
        with pytest.raises(InputError, match=named):
            MeshGenerator(glb.write(tmp_path / "a.glb"), spacing=0.05).generate(observation, 0)
    with pytest.raises(InputError, match="format"):
        MeshGenerator(tmp_path / "a.stl").generate(observation, 0)
    with pytest.raises(InputError, match="axis convention"):
        MeshGenerator(tmp_path / "a.glb", "sideways")
