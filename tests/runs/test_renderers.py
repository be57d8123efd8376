"""What draws each arm, and what its images are known by."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from recast.cameras import CameraMount
from recast.runs.arms import Arm, parse_arms
from recast.runs.artefacts import Artefacts
from recast.runs.rollouts import Renderers
from recast.simulation import SimState
from recast.simulation.oracle_renderer import OracleRenderer
from recast.simulation.renderer import jittered
from recast.simulation.scene_renderer import SceneRenderer
from recast.synthetic.world import World, make_rig
from support.oracle_states import at_camera, ball, state_of, street
from support.small_street import small_world

WORDS = ["native", "oracle", "noise-floor", "recast+oracle", "recast+none", "oracle+none"]
NEGATIVE = "support.own_parts:Negative"
ARMS = {arm.name: arm for arm in (*parse_arms(WORDS), Arm.replaced("box", "truth"))}


@pytest.fixture(scope="module")
def world() -> World:
    return small_world()


@pytest.fixture(scope="module")
def mounts() -> dict[str, CameraMount]:
    rig = make_rig(96, 64, ("front",)).cameras
    return {k: CameraMount(c.camera, c.rig_from_camera) for k, c in rig.items()}


@pytest.fixture(scope="module")
def state(world: World) -> SimState:
    return state_of(world, 2)


def no_actor(arm: Arm, track: str) -> None:
    raise AssertionError("no coverage is asked for")


@pytest.fixture(scope="module")
def images(
    world: World, mounts: dict[str, CameraMount], state: SimState
) -> Iterator[dict[str, np.ndarray]]:
    """The front camera's image under each arm."""
    scene = street(world, ball((0.0, 0.0, 1.0), at_camera(state, mounts["front"], 30.0), 2.0))
    renderers = Renderers(lambda *_: scene, no_actor, lambda: world, 1)  # type: ignore[arg-type]
    tracks = (world.target,)
    yield {
        name: renderers.of(arm, tracks, "p", mounts).render(state, ["front"])["front"]
        for name, arm in ARMS.items()
    }
    renderers.close()


def test_noise_changes_what_it_says_and_nothing_else(images: dict[str, np.ndarray]) -> None:
    truth = images["oracle"]
    np.testing.assert_array_equal(images["oracle:start"], truth)
    np.testing.assert_array_equal(images["oracle:jitter"], jittered(truth))
    inside = (truth > 0) & (truth < 255)
    step = np.abs(images["oracle:grey"].astype(int) - truth)
    assert (step[inside] == 1).all() and step.max() == 1
    noise = np.abs(images["oracle:seed"].astype(int) - truth)
    assert noise.any() and noise.mean() < 3


def test_streets_without_a_vehicle(
    images: dict[str, np.ndarray], world: World, mounts: dict[str, CameraMount], state: SimState
) -> None:
    scene = street(world, ball((0.0, 0.0, 1.0), at_camera(state, mounts["front"], 30.0), 2.0))
    bare = SceneRenderer(scene, mounts, absent=[world.target]).render(state, ["front"])["front"]
    np.testing.assert_array_equal(images["recast+none"], bare)
    assert (images["native"] != bare).any(), "its own model"
    with OracleRenderer(world, mounts, 1, tracks=[world.target]) as renderer:
        true = renderer.render(state, ["front"])["front"]
    np.testing.assert_array_equal(images["oracle+none"], true)
    assert (images["oracle+box"] != true).any() and (images["recast+oracle"] != bare).any()


def made_with(restorer: str | None) -> SimpleNamespace:
    """What `Artefacts.images_of` asks for."""
    return SimpleNamespace(
        scene=lambda arm: SimpleNamespace(reference=f"scene of {arm.made_in}"),
        config=SimpleNamespace(restorer=restorer),
        sources=SimpleNamespace(restorers={NEGATIVE: "content"}),
    )


def test_images_of_other_arms_have_other_keys() -> None:
    made = made_with(None)
    arms = {**ARMS, "unlit": Arm(name="unlit", vehicle="generated", relit=False)}
    keys = {name: Artefacts.images_of(made, arm) for name, arm in arms.items()}  # type: ignore[arg-type]
    assert keys["native"] == {"street": "scene of recast"}
    assert keys["oracle"] == {"street": "truth"}
    assert keys["oracle+box"] == {"street": "truth", "lit_by": "scene of recast"}
    assert len({str(key) for key in keys.values()}) == len(keys)


def test_all_images_but_those_of_the_truth_are_restored(
    images: dict[str, np.ndarray], world: World, mounts: dict[str, CameraMount], state: SimState
) -> None:
    scene = street(world, ball((0.0, 0.0, 1.0), at_camera(state, mounts["front"], 30.0), 2.0))
    renderers = Renderers(lambda *_: scene, no_actor, lambda: world, 1, NEGATIVE)  # type: ignore[arg-type]
    tracks, restored = (world.target,), []
    for name, arm in ARMS.items():
        found = renderers.of(arm, tracks, "p", mounts).render(state, ["front"])["front"]
        if arm.restorable:
            restored.append(name)
        np.testing.assert_array_equal(found, 255 - images[name] if arm.restorable else images[name])
    renderers.close()
    assert restored == ["native", "recast+oracle", "recast+none", "oracle+box"]


def test_keys_of_restored_images_name_the_restorer() -> None:
    plain, restored = made_with(None), made_with(NEGATIVE)
    for arm in ARMS.values():
        before = Artefacts.images_of(plain, arm)  # type: ignore[arg-type]
        after = Artefacts.images_of(restored, arm)  # type: ignore[arg-type]
        assert after == {**before, **({"restorer": "content"} if arm.restorable else {})}
