from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import Trajectory
from recast.planning import ConstantVelocity, Plan, PlannerInput
from recast.planning.gtrs import nuplan_rig
from recast.scene.street_scene import StreetScene
from recast.simulation import (
    MOTIONS,
    RolloutSetup,
    SimActor,
    SimState,
    camera_mounts,
    run_rollout,
)
from recast.simulation.recorded_drive import RecordedDrive
from recast.simulation.scene_renderer import SceneRenderer, through_lenses
from support.camera_drives import CAMERA, RIG_FROM_CAMERA, log_with_camera


def at(x: float, y: float, z: float) -> np.ndarray:
    return se3.from_rotation_translation(np.eye(3), [x, y, z])


def state(**others: np.ndarray) -> SimState:
    return SimState(
        step=0,
        timestamp_us=0,
        ego=np.zeros(11),
        log_ego=np.zeros(4),
        world_from_rig=at(10.0, 0.0, 0.0),
        track_id="7",
        actor=np.zeros(4),
        world_from_actor=at(21.5, 0.0, 1.0),
        others=others,
    )


def test_mounts_are_rectified_and_scaled() -> None:
    log = log_with_camera()
    distorted = replace(CAMERA, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))
    log = replace(log, cameras={"front": replace(log.cameras["front"], camera=distorted)})
    mount = camera_mounts(log, scale=0.5)["front"]
    assert mount.camera.is_rectified
    assert (mount.camera.width, mount.camera.height, mount.camera.fx) == (32, 24, 20.0)
    np.testing.assert_array_equal(mount.rig_from_camera, RIG_FROM_CAMERA)


def test_an_unknown_camera_lists_the_known() -> None:
    with pytest.raises(InputError, match="camera rear: is not in the log; choose one of front"):
        camera_mounts(log_with_camera(), ["rear"])


def test_the_controlled_actor_is_drawn_where_the_state_has_it(scene: StreetScene) -> None:
    renderer = SceneRenderer(scene, camera_mounts(log_with_camera()))
    image = renderer.render(state(), ["front"])["front"]
    assert image.shape == (48, 64, 3)
    assert image.dtype == np.uint8
    # 10 m ahead of the camera and at its height: the centre of the image
    assert image[24, 32, 0] > 200
    assert image[24, 32, 1:].max() < 30
    left = replace(state(), world_from_actor=at(21.5, 4.0, 1.0))
    moved = renderer.render(left, ["front"])["front"]
    assert moved[24, 16, 0] > 200  # 40 px * 4 m / 10 m to the left
    assert moved[24, 32, 0] < 30


def test_of_a_window_everything_else_is_black(scene: StreetScene) -> None:
    mounts = camera_mounts(log_with_camera())
    parts = {"front": replace(mounts["front"], window=(20, 10, 50, 41))}
    whole = SceneRenderer(scene, mounts).render(state(), ["front"])["front"].astype(int)
    part = SceneRenderer(scene, parts).render(state(), ["front"])["front"].astype(int)
    assert part.shape == whole.shape and whole[10:41, 20:50].max() > 200
    np.testing.assert_array_equal(part[10:41, 20:50], whole[10:41, 20:50])
    part[10:41, 20:50] = 0
    assert not part.any()


def test_others_are_drawn_only_where_they_stay(scene: StreetScene) -> None:
    renderer = SceneRenderer(scene, camera_mounts(log_with_camera()))
    beside = at(21.5, -4.0, 1.0)
    assert renderer.render(state(), ["front"])["front"][24, 48, 1] < 30
    assert renderer.render(state(**{"9": beside}), ["front"])["front"][24, 48, 1] > 200
    # a track without a model in the scene is part of its background
    renderer.render(state(**{"not modelled": beside}), ["front"])


def test_at_a_moment_of_the_log_the_scene_stands_as_training_learned(scene: StreetScene) -> None:
    log = log_with_camera()
    mount = camera_mounts(log)["front"]
    times = np.array([6_000_000, 7_000_000])
    twists = np.zeros((2, 6))
    twists[:, 0] = 0.5, 1.5  # metres to the right in the camera's frame
    mean = RIG_FROM_CAMERA @ se3.inverse(at(1.0, 0.0, 0.0)) @ se3.inverse(RIG_FROM_CAMERA)
    poses = np.tile(at(21.5, 0.0, 1.0), (2, 1, 1))
    refined = replace(scene.actors["7"], trajectory=Trajectory(times, poses))
    scene = replace(
        scene,
        actors={**scene.actors, "7": refined},
        camera_corrections={"front": (times, twists)},
        mounts={"front": mean},
    )
    virtual = replace(mount, source="front")
    renderer = SceneRenderer(scene, {"front": mount, "virtual": virtual})

    def middle(now: SimState, name: str) -> float:
        red = renderer.render(now, [name])[name][24, :, 0] > 200
        return float(np.flatnonzero(red).mean()) + 0.5

    drive = RecordedDrive(log, ConstantVelocity())
    for time, metres in zip(times.tolist(), (0.5, 1.5), strict=True):
        logged = replace(drive.state(time), world_from_rig=at(10.0, 0.0, 0.0))
        logged = replace(logged, others={"7": at(21.5, 4.0, 1.0)})  # as labelled
        for name in ("front", "virtual"):
            assert middle(logged, name) == pytest.approx(32 + 40 * metres / 10, abs=1.0)
    # A simulated drive has not the noise of the log's poses, only what is the same at all times.
    assert middle(state(), "front") == pytest.approx(32 + 40 * 1.0 / 10, abs=1.0)


def test_a_scene_without_the_actor_is_refused(scene: StreetScene) -> None:
    renderer = SceneRenderer(replace(scene, actors={}), camera_mounts(log_with_camera()))
    with pytest.raises(InputError, match="actor 7: has no model in the scene"):
        renderer.render(state(), ["front"])


def test_further_controlled_actors_are_drawn_and_need_a_model(scene: StreetScene) -> None:
    renderer = SceneRenderer(scene, camera_mounts(log_with_camera()))
    further = SimActor(np.zeros(4), at(21.5, -4.0, 1.0))
    both = replace(state(), further={"9": further})
    assert renderer.render(both, ["front"])["front"][24, 48, 1] > 200
    with pytest.raises(
        InputError, match=r"actor none: has no model in the scene; .* has models of 7, 9"
    ):
        renderer.render(replace(state(), further={"none": further}), ["front"])


def test_a_planner_that_names_nuplans_cameras_sees_the_scene_through_them(
    scene: StreetScene,
) -> None:
    class Looker(ConstantVelocity):
        name, needs_images, camera_names = "looker", True, ("nuplan_l0", "nuplan_f0", "nuplan_r0")
        seen: tuple[Mapping[str, np.ndarray], ...] = ()

        def plan(self, observation: PlannerInput) -> Plan:
            self.seen = (*self.seen, observation.images)
            return super().plan(observation)

    log, planner = log_with_camera(), Looker()
    mounts = camera_mounts(log) | nuplan_rig(0.05)
    renderer = through_lenses(mounts, lambda sources: SceneRenderer(scene, sources))
    run_rollout(RolloutSetup(log, "7", MOTIONS["stationary-a"], steps=10), planner, renderer)
    images = planner.seen[0]
    assert list(images) == list(planner.camera_names) and len(planner.seen) == 2
    assert all(image.shape == (54, 96, 3) for image in images.values())
    red = images["nuplan_f0"][..., 0].astype(int) - images["nuplan_f0"][..., 2]
    rows, columns = np.nonzero(red > 128)
    assert len(rows) and abs(columns.mean() - 48) < 3, "the red actor stands straight ahead"
    assert (images["nuplan_l0"][..., 0] < 64).all()


def test_a_film_of_a_rollout(scene: StreetScene) -> None:
    log = log_with_camera()
    frames: list[np.ndarray] = []
    setup = RolloutSetup(log, "7", MOTIONS["cut-in-a"], steps=10)
    renderer = SceneRenderer(scene, camera_mounts(log, scale=0.5))
    run_rollout(
        setup, ConstantVelocity(), renderer, lambda _, images: frames.append(images["front"])
    )
    assert len(frames) == 10
    assert all(frame.shape == (24, 32, 3) for frame in frames)
    red = [int(frame[..., 0].max()) for frame in frames]
    assert max(red) > 100  # the car ahead is in view
