from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.simulation.oracle_renderer import OracleRenderer
from recast.synthetic.world import World, exposure, make_rig
from recast.synthetic.write import Oracle, OraclePool
from support.oracle_states import state_of
from support.small_street import small_world

WIDTH, HEIGHT = 96, 64


@pytest.fixture(scope="module")
def world() -> World:
    return small_world()


@pytest.fixture(scope="module")
def mounts() -> dict[str, CameraMount]:
    rig = make_rig(WIDTH, HEIGHT)
    return {k: CameraMount(c.camera, c.rig_from_camera) for k, c in rig.cameras.items()}


def test_at_the_logged_state_it_shows_what_the_log_shows(
    world: World, mounts: dict[str, CameraMount]
) -> None:
    oracle, state = Oracle(world), state_of(world, 3)
    with OracleRenderer(world, mounts, workers=1) as renderer:
        images = renderer.render(state, list(mounts))
    for name, mount in mounts.items():
        frame = oracle.render(
            mount.camera,
            state.world_from_rig @ mount.rig_from_camera,
            timestamp_us=state.timestamp_us,
            exposure=exposure(world.seed, name),
            rng=np.random.default_rng(99),
        )
        error = np.mean((frame.rgb.astype(float) - images[name]) ** 2)
        assert 10 * np.log10(255**2 / max(error, 1e-9)) > 35, name
        assert abs(frame.rgb.mean() - images[name].mean()) < 0.4, f"{name}: exposure"


def test_a_window_shows_the_same_and_black_around(
    world: World, mounts: dict[str, CameraMount]
) -> None:
    state, window = state_of(world, 3), (10, 8, 81, 60)
    parts = {name: replace(mount, window=window) for name, mount in mounts.items()}
    with (
        OracleRenderer(world, mounts, workers=1) as whole,
        OracleRenderer(world, parts, workers=1) as cropped,
    ):
        images, found = whole.render(state, list(mounts)), cropped.render(state, list(mounts))
    for name in mounts:
        inside = np.s_[8:60, 10:81]
        np.testing.assert_array_equal(found[name][inside], images[name][inside])
        found[name][inside] = 0
        assert not found[name].any()


def test_images_do_not_depend_on_workers_or_order(
    world: World, mounts: dict[str, CameraMount]
) -> None:
    state = state_of(world, 2)
    with OracleRenderer(world, mounts, workers=1) as renderer:
        expected = renderer.render(state, list(mounts))
        backwards = renderer.render(state, list(mounts)[::-1])
    with OracleRenderer(world, mounts, workers=2) as renderer:
        found = renderer.render(state, list(mounts))
    for name in mounts:
        assert expected[name].shape == (HEIGHT, WIDTH, 3)
        assert expected[name].dtype == np.uint8
        np.testing.assert_array_equal(expected[name], found[name])
        np.testing.assert_array_equal(expected[name], backwards[name])


def test_renderers_may_share_processes_that_none_of_them_closes(
    world: World, mounts: dict[str, CameraMount]
) -> None:
    state = state_of(world, 1)
    with OracleRenderer(world, mounts, workers=1) as own, OraclePool(world, 2) as pool:
        expected = own.render(state, ["front"])["front"]
        for noise, same in ((0, True), (1, False), (0, True)):
            with OracleRenderer(world, mounts, noise=noise, pool=pool) as shared:
                image = shared.render(state, ["front"])["front"]
            assert np.array_equal(image, expected) == same


def test_the_actor_goes_where_the_state_has_it(
    world: World, mounts: dict[str, CameraMount]
) -> None:
    state = state_of(world, 0)
    moved = state.world_from_actor.copy()
    moved[:3, 3] += 9.0 * moved[:3, 0]
    with OracleRenderer(world, mounts, workers=1) as renderer:
        before = renderer.render(state, ["front"])["front"]
        after = renderer.render(replace(state, world_from_actor=moved), ["front"])["front"]
    assert np.mean(before != after) > 0.02


def test_an_actor_that_the_world_lacks(world: World, mounts: dict[str, CameraMount]) -> None:
    state = replace(state_of(world, 0), track_id="9")
    with (
        OracleRenderer(world, mounts, workers=1) as renderer,
        pytest.raises(InputError, match="track 9"),
    ):
        renderer.render(state, ["front"])
