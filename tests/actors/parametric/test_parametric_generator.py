from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from recast.actors import Observation
from recast.actors.icp import bounds
from recast.actors.parametric import (
    ParametricGenerator,
    ParametricModel,
    ParametricVehicle,
    VehicleLook,
    predict_design,
)
from recast.actors.parametric.network import SHAPES, condition_of, unwrapped
from recast.actors.template.design import STYLES
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.scene.actor import look_at
from support import made_up_actors as made_up

SIZE = np.array([4.4, 1.8, 1.5])
LOOK = VehicleLook(0.5, 0.1, 0.2, -1.0, 0.3, 0.8, 0.4, 0.5, 0.6)


@pytest.fixture(scope="module")
def model() -> ParametricModel:
    with torch.random.fork_rng():
        torch.manual_seed(3)
        made = ParametricModel.fresh(channels=(8, 8, 8, 8), feature=16, hidden=16, depth=1)
        for parameter in made.network.parameters():
            torch.nn.init.normal_(parameter, std=0.1)
    numbers, _ = made.codec.encode(ParametricVehicle("estate", STYLES["estate"], LOOK))
    made.network.centre.copy_(torch.from_numpy(numbers))
    made.network.spread.fill_(0.003)
    return made


def test_seeds_give_vehicles_that_fill_the_box(
    model: ParametricModel, observation: Observation
) -> None:
    generator = ParametricGenerator(model, spacing=0.06)
    first, again, other = (generator.generate(observation, seed) for seed in (4, 4, 5))
    assert torch.equal(first.gaussians.means, again.gaussians.means)
    assert torch.equal(first.gaussians.sh, again.gaussians.sh)
    assert not torch.equal(first.gaussians.means, other.gaussians.means)
    paint = [float(v) for v in str(first.details["paint_srgb"]).split()]
    np.testing.assert_allclose(paint, made_up.RED, atol=0.1)  # measured, not told
    low, high = bounds(first.gaussians.means.double().numpy())
    np.testing.assert_allclose((high - low)[0], observation.size[0], atol=0.15)
    assert low[2] == pytest.approx(-observation.size[2] / 2, abs=0.05)
    assert len(generator.candidates(observation, 0)) == 4


def test_without_paint_in_view_the_model_tells_it(
    model: ParametricModel, observation: Observation
) -> None:
    rgba = observation.rgba.copy()
    rgba[::2, :, 3] = 0  # stripes: no patch lies well inside the mask
    made = ParametricGenerator(model, spacing=0.06).generate(replace(observation, rgba=rgba), 0)
    paint = [float(v) for v in str(made.details["paint_srgb"]).split()]
    np.testing.assert_allclose(paint, [LOOK.red, LOOK.green, LOOK.blue], atol=0.01)


def test_the_prediction_tells_its_uncertainty(
    model: ParametricModel, observation: Observation
) -> None:
    told = predict_design(observation, model)
    assert sum(told.styles.values()) == pytest.approx(1.0, abs=1e-5)
    assert told.vehicle.style == next(iter(told.styles))
    assert all(value > 0 for value in told.uncertainty.values())
    drawn = told.samples(1, 3)
    assert len(set(drawn)) == 3
    assert drawn == told.samples(1, 3)


def test_weights_come_back_and_must_fit_the_designs(
    model: ParametricModel, observation: Observation, tmp_path: Path
) -> None:
    path = tmp_path / "model.safetensors"
    model.save(path)
    loaded = ParametricModel.load(path)
    was, now = (predict_design(observation, one).vehicle.look for one in (model, loaded))
    assert now.red == pytest.approx(was.red, abs=1e-2)
    with safe_open(path, framework="pt") as file:
        header = file.metadata()
    header = {name: text.replace("front.lamp_z", "front.lamp_y") for name, text in header.items()}
    save_file(load_file(path), path, metadata=header)
    with pytest.raises(InputError, match=r"design\.front\.lamp_[yz].*train it again"):
        ParametricModel.load(path)


def test_tail_lamps_stay_below_the_lid(model: ParametricModel) -> None:
    sedan = STYLES["sedan"]
    high = replace(sedan, rear=replace(sedan.rear, lamp_low=0.6, lamp_high=0.8))
    codec = model.codec
    made = model.vehicle(*codec.encode(ParametricVehicle("sedan", high, LOOK))).design
    assert made.rear.lamp_high < sedan.proportions.deck_z
    assert made.rear.lamp_low < made.rear.lamp_high - 0.05
    usual = ParametricVehicle("sedan", sedan, LOOK)
    assert model.vehicle(*codec.encode(usual)) == usual
    tall = ParametricVehicle("kei", STYLES["kei"], LOOK)  # has no lid
    assert model.vehicle(*codec.encode(tall)) == tall


def planes(side: float, azimuth: float = 2.4) -> dict[str, np.ndarray]:
    """Planes of a box that is red on its sides and blue behind, with the eye left or right."""
    camera = PinholeCamera(400, 300, 500.0, 500.0, 200.0, 150.0)
    eye = np.array([9 * np.cos(azimuth), side * 9 * np.sin(azimuth), 0.6])
    pose = look_at(eye, np.zeros(3))
    rays = camera.rays(camera.pixel_grid().reshape(-1, 2)) @ pose[:3, :3]
    rgba = np.zeros((300 * 400, 4), np.uint8)
    for axis, sign, colour in ((1, side, (255, 0, 0)), (0, -1, (0, 0, 255))):
        depth = (sign * SIZE[axis] / 2 - eye[axis]) / rays[:, axis]
        hits = eye + depth[:, None] * rays
        inside = np.all(np.abs(np.delete(hits, axis, 1)) < np.delete(SIZE, axis) / 2, axis=1)
        rgba[inside & (depth > 0)] = (*colour, 255)
    made = unwrapped(rgba.reshape(300, 400, 4), camera, pose, SIZE, "car", np.full(3, np.nan))
    ends = np.cumsum([rows * columns for rows, columns in SHAPES.values()])[:-1]
    parts = np.split(made.planes, ends)
    return {
        name: part.reshape(*shape, 5)
        for (name, shape), part in zip(SHAPES.items(), parts, strict=True)
    }


def test_the_crop_is_unwrapped_onto_the_sides_of_the_box() -> None:
    seen = planes(1.0)
    inner = {name: image[6:-6, 6:-6] for name, image in seen.items()}
    assert (inner["side"][..., 0] > 200).mean() > 0.99
    assert (inner["rear"][..., 2] > 200).mean() > 0.99
    assert seen["front"][..., 4].max() == 0  # turned away
    mirrored = planes(-1.0)
    for name in SHAPES:
        apart = np.abs(seen[name].astype(int) - mirrored[name]) > 60
        assert apart.mean() < 0.03, name


def test_a_far_photograph_gives_the_same_planes(observation: Observation) -> None:
    """A photograph of twice the size tells the same."""
    width, height = 2 * observation.camera.width, 2 * observation.camera.height
    larger = replace(
        observation,
        rgba=observation.rgba.repeat(2, axis=0).repeat(2, axis=1),
        camera=observation.camera.resized(width, height),
    )
    first, second = condition_of(observation).planes, condition_of(larger).planes
    assert np.abs(first.astype(int) - second).mean() < 8
