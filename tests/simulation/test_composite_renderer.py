"""The true vehicle in a street of Gaussians, and Gaussians in the true street."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from recast.cameras import CameraMount
from recast.geometry import se3
from recast.simulation import SimState
from recast.simulation.oracle_renderer import (
    GeneratedVehicleRenderer,
    OracleRenderer,
    TrueVehicleRenderer,
)
from recast.simulation.scene_renderer import SceneRenderer
from recast.synthetic.world import World, exposure, make_rig
from recast.synthetic.write import Oracle
from support.oracle_states import at_camera, ball, state_of, street
from support.small_street import small_world

AHEAD_M = 14.0


@pytest.fixture(scope="module")
def world() -> World:
    return small_world()


@pytest.fixture(scope="module")
def mounts() -> dict[str, CameraMount]:
    rig = make_rig(96, 64, ("front",)).cameras
    return {k: CameraMount(c.camera, c.rig_from_camera) for k, c in rig.items()}


@pytest.fixture(scope="module")
def state(world: World) -> SimState:
    """The target straight ahead, turned, and nobody else."""
    found = state_of(world, 3)
    pose = found.world_from_rig.copy()
    pose[:3, 3] += AHEAD_M * pose[:3, 0]
    pose[2, 3] = found.world_from_actor[2, 3]
    pose[:3, :3] = pose[:3, :3] @ se3.rotation_z(0.5)
    return replace(found, world_from_actor=pose, others={})


def test_the_true_vehicle_stands_in_the_street_with_its_shadow(
    world: World, mounts: dict[str, CameraMount], state: SimState
) -> None:
    mount = mounts["front"]
    far = street(world, ball((0.0, 0.0, 1.0), at_camera(state, mount, -50.0), 0.5))
    with TrueVehicleRenderer(world, far, mounts, 1, tracks=[world.target]) as renderer:
        image = renderer.render(state, ["front"])["front"]
        again = renderer.render(state, ["front"])["front"]
    np.testing.assert_array_equal(image, again)
    bare = SceneRenderer(far, mounts, absent=[world.target]).render(state, ["front"])["front"]
    assert np.ptp(bare) <= 1, "its own model is left out"
    pose = state.world_from_rig @ mount.rig_from_camera
    oracle, light = Oracle(world), exposure(world.seed, "front")
    known = {"exposure": light, "rng": np.random.default_rng([world.seed, 701])}
    alone = oracle.render(mount.camera, pose, state.poses, alone=[world.target], **known)
    inside = alone.alpha == 1
    assert inside.sum() > 100
    # Only the rays' samples differ.
    assert np.abs(image[inside].astype(int) - alone.rgb[inside]).mean() < 3
    outside = alone.alpha == 0
    # The red paint throws some light back: brighter than the grey of 153, but no rim.
    assert (image[outside] <= 160).all(), "no halo"
    below = outside.copy()
    below[: int(np.nonzero(inside)[0].max())] = False
    assert (image[below] < 110).any(), "a shadow on the road"
    above = outside.copy()
    above[int(np.nonzero(inside)[0].min()) - 3 :] = False
    # Light that the vehicle throws back reaches the houses too.
    assert np.abs(image[above].astype(int) - bare[above]).max() <= 2, "and nowhere else"


def test_composites_have_the_exposure_that_the_street_has_learned(
    world: World, mounts: dict[str, CameraMount], state: SimState
) -> None:
    """Half the red, and a tenth of white more, in all that is of the street or its vehicles."""
    mount, tracks = mounts["front"], [world.target]
    change = torch.tensor([[0.5, 0, 0, 0.1], [0, 1, 0, 0.1], [0, 0, 1, 0.1]])
    far = ball((0.0, 0.0, 1.0), at_camera(state, mount, -50.0), 0.5)
    learned = {"front": (np.array([0]), change[None].numpy())}
    bare, changed = (
        replace(street(world, far, ball((1.0, 0.0, 0.0), np.zeros(3), 0.5)), exposures=one)
        for one in ({}, learned)
    )
    for kind in (TrueVehicleRenderer, GeneratedVehicleRenderer):
        images = []
        for scene in (bare, changed):
            with kind(world, scene, mounts, 1, tracks=tracks) as renderer:
                images.append(renderer.render(state, ["front"])["front"] / 255)
        before, after = images
        if kind is TrueVehicleRenderer:  # of the street, far from the vehicle and its shadow
            before, after = before[:8], after[:8]
        else:  # of the vehicle, where nothing else is seen
            red = (before[..., 0] > 0.95) & (before[..., 1:].max(axis=-1) < 0.02)
            assert red.sum() >= 4
            before, after = before[red], after[red]
        expected = before @ change[:, :3].numpy().T + change[:, 3].numpy()
        np.testing.assert_allclose(after, expected.clip(0, 1), atol=0.02)


def test_a_street_that_is_nearer_hides_the_true_vehicle(
    world: World, mounts: dict[str, CameraMount], state: SimState
) -> None:
    mount = mounts["front"]
    images = []
    for metres in (3.0, 60.0):
        scene = street(world, ball((0.0, 0.0, 1.0), at_camera(state, mount, metres), metres / 4))
        with TrueVehicleRenderer(world, scene, mounts, 1, tracks=[world.target]) as renderer:
            images.append(renderer.render(state, ["front"])["front"].astype(int))
    pixel, _ = mount.camera.project(
        se3.apply(
            se3.inverse(state.world_from_rig @ mount.rig_from_camera),
            state.world_from_actor[None, :3, 3],
        )
    )
    column, row = pixel[0].astype(int)
    near, behind = (image[row, column] for image in images)
    assert near[2] > 240 and near[:2].max() < 15, "the blue ball"
    assert behind[2] < behind[:2].max() + 60, "the vehicle"


def test_gaussians_in_the_true_street(
    world: World, mounts: dict[str, CameraMount], state: SimState
) -> None:
    nothing = ball((0.0, 0.0, 1.0), at_camera(state, mounts["front"], 3.0), 1.0)
    red = street(world, nothing, ball((1.0, 0.0, 0.0), np.zeros(3), 0.5))
    with (
        GeneratedVehicleRenderer(world, red, mounts, 1, tracks=[world.target]) as renderer,
        OracleRenderer(world, mounts, 1, tracks=[world.target]) as empty,
    ):
        image = renderer.render(state, ["front"])["front"]
        without = empty.render(state, ["front"])["front"]
        sunk = state.world_from_actor.copy()
        sunk[2, 3] -= 8.0
        hidden = renderer.render(replace(state, world_from_actor=sunk), ["front"])["front"]
    changed = (image != without).any(axis=2)
    assert 20 < changed.sum() < changed.size / 4
    assert (image[..., 0].astype(int) - image[..., 2]).max() > 200, "red, and no blue street"
    np.testing.assert_array_equal(hidden, without), "under the road"


def test_the_true_street_without_and_with_another_noise(
    world: World, mounts: dict[str, CameraMount], state: SimState
) -> None:
    images = {}
    for name, arguments in {
        "truth": {},
        "noise": {"noise": 1},
        "none": {"tracks": [world.target]},
    }.items():
        with OracleRenderer(world, mounts, 1, **arguments) as renderer:
            images[name] = renderer.render(state, ["front"])["front"].astype(int)
    noise = np.abs(images["noise"] - images["truth"])
    assert noise.any() and noise.mean() < 3, "the same picture with other rays"
    assert (np.abs(images["none"] - images["truth"]).max(axis=2) > 30).mean() > 0.01
