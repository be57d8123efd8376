"""What a NAVSIM agent is shown, what is made of its answer, and what is refused."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.cameras import CameraMount, PinholeCamera
from recast.cameras.mounts import camera_pose
from recast.core.errors import InputError
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.logs import DrivingLog, Track, Trajectory
from recast.planning import Planner, camera_choice, make_planner, planner_cameras
from recast.simulation import MOTIONS, NullRenderer, Rollout, RolloutSetup, run_rollout
from recast_bridges.navsim import (
    NAVSIM_CAMERAS,
    NUPLAN_RIG,
    AgentInput,
    NavsimPlanner,
    SensorConfig,
    TrajectorySampling,
    resample,
)
from recast_bridges.navsim import Trajectory as NavsimTrajectory

CAMERA = PinholeCamera(12, 8, 10.0, 10.0, 6.0, 4.0)
WAYMO = {
    name: CameraMount(CAMERA, camera_pose((1.5, 0.1, 2.0), yaw, 0.0))
    for name, yaw in {"front": 0.5, "front_left": 45, "front_right": -45, "side_left": 90}.items()
}
SPEED = 8.0


class Recorder:
    """Drives straight on and keeps what it was shown."""

    def __init__(self, config: Any = None, answer: Callable[[], Any] | None = None) -> None:
        self.config = config or SensorConfig.build_no_sensors()
        self.answer = answer
        self.seen: list[AgentInput] = []
        self.initialised = 0

    def name(self) -> str:
        return "my agent"

    def initialize(self) -> None:
        self.initialised += 1

    def get_sensor_config(self) -> Any:
        return self.config

    def compute_trajectory(self, agent_input: AgentInput) -> Any:
        self.seen.append(agent_input)
        if self.answer is not None:
            return self.answer()
        poses = np.zeros((8, 3), np.float32)
        poses[:, 0] = SPEED * 0.5 * np.arange(1, 9)
        return NavsimTrajectory(poses)


class Numbered(NullRenderer):
    """Every pixel is the step."""

    def render(self, state: Any, camera_names: Any) -> dict[str, np.ndarray]:
        images = super().render(state, camera_names)
        return {name: image + np.uint8(state.step) for name, image in images.items()}


def _log(curvature: float = 0.0) -> DrivingLog:
    """Twelve seconds at 8 m/s and a parked car."""
    times = np.arange(121, dtype=np.int64)
    s = 0.8 * times
    xy = np.stack([s, np.zeros(121)], -1)
    if curvature:
        xy = np.stack([np.sin(curvature * s), 1 - np.cos(curvature * s)], -1) / curvature
    poses = np.concatenate([xy, (curvature * s)[:, None]], axis=1)
    drive = Trajectory(times * 100_000, se2.to_se3(poses))
    parked = Trajectory(drive.timestamps_us, se2.to_se3(np.tile([5.0, 60.0, 0.0], (121, 1))))
    return DrivingLog(
        "made", {}, {}, drive, {"7": Track("7", "car", np.array([4.2, 1.8, 1.5]), parked)}
    )


def _run(planner: Planner, log: DrivingLog | None = None, start: int = 0, **more: Any) -> Rollout:
    setup = RolloutSetup(
        log or _log(),
        "7",
        MOTIONS["advancing-a"],
        steps=15,
        start_timestamp_us=start * 100_000,
        **more,
    )
    return run_rollout(setup, planner, Numbered(WAYMO))


def test_the_history_is_the_egos_in_the_present_frame() -> None:
    agent = Recorder()
    planner = NavsimPlanner(agent)
    assert (planner.name, planner.needs_images, agent.initialised) == ("my-agent", False, 1)
    _run(planner, _log(curvature=0.02), start=20)
    assert agent.initialised == 1 and len(agent.seen) == 3
    statuses = agent.seen[0].ego_statuses
    assert len(statuses) == len(agent.seen[0].cameras) == len(agent.seen[0].lidars) == 4
    poses = np.array([status.ego_pose for status in statuses])
    np.testing.assert_allclose(poses[-1], 0.0, atol=1e-6)
    # On a left bend the past lies behind, to the left, with headings to the right.
    angle = 0.02 * SPEED * np.array([-1.5, -1.0, -0.5, 0.0])
    expected = np.stack([np.sin(angle), 1 - np.cos(angle), 0.02 * angle], -1) / 0.02
    np.testing.assert_allclose(poses, expected, atol=0.02)
    for status in statuses:
        assert status.driving_command.tolist() == [1, 0, 0, 0] and not status.in_global_frame
        np.testing.assert_allclose(status.ego_velocity, [SPEED, 0.0], atol=0.02)
        np.testing.assert_allclose(status.ego_acceleration, [0.0, 0.02 * SPEED**2], atol=0.05)
    assert all(lidar.lidar_pc is None for lidar in agent.seen[0].lidars)


def test_before_the_log_constant_velocity_is_assumed() -> None:
    agent = Recorder()
    _run(NavsimPlanner(agent), start=3)
    poses = np.array([status.ego_pose for status in agent.seen[0].ego_statuses])
    np.testing.assert_allclose(poses[:, 0], SPEED * np.array([-1.5, -1.0, -0.5, 0.0]), atol=0.02)


def test_cameras_by_yaw_and_by_frame() -> None:
    agent = Recorder(SensorConfig(cam_f0=[2, 3], cam_l0=True, cam_r0=[3], cam_l1=[3]))
    planner = NavsimPlanner(agent)
    assert planner.needs_images and planner.camera_names is None
    chosen = {"cam_f0": "front", "cam_l0": "front_left", "cam_l1": "side_left"}
    chosen["cam_r0"] = "front_right"
    assert camera_choice(planner, WAYMO) == chosen
    assert planner_cameras(planner, WAYMO) == tuple(chosen.values())
    _run(planner)
    first, last = agent.seen[0].cameras, agent.seen[-1].cameras
    assert [c.cam_f0.image is None for c in last] == [True, True, False, False]
    assert [int(c.cam_l0.image[0, 0, 0]) for c in last] == [0, 0, 5, 10]
    assert [int(c.cam_l0.image[0, 0, 0]) for c in first] == [0, 0, 0, 0]
    assert all(c.cam_b0.image is None for c in last)
    camera = last[-1].cam_l0
    assert camera.image.shape == (8, 12, 3) and camera.image.dtype == np.uint8
    np.testing.assert_allclose(camera.sensor2lidar_translation, [1.5, 0.1, 2.0])
    axis = camera.sensor2lidar_rotation[:, 2]
    np.testing.assert_allclose(axis, [np.sqrt(0.5), np.sqrt(0.5), 0.0], atol=1e-12)
    np.testing.assert_allclose(camera.intrinsics, [[10, 0, 5.5], [0, 10, 3.5], [0, 0, 1]])
    assert WAYMO["front_left"].camera.cx == 6.0


def test_a_camera_that_nothing_looks_like_is_named() -> None:
    planner = NavsimPlanner(Recorder(SensorConfig(cam_b0=[3])))
    message = r"^planner my-agent: camera cam_b0: is needed, .* of 180 .*there are front \(ahead, 6"
    with pytest.raises(InputError, match=message):
        _run(planner)


def test_each_camera_stands_for_one_only() -> None:
    planner = NavsimPlanner(Recorder(SensorConfig(cam_f0=[3], cam_l0=[3])))
    with pytest.raises(InputError, match="camera cam_l0: is needed"):
        planner_cameras(planner, {"a": WAYMO["front"], "b": WAYMO["front"]})


def test_named_cameras() -> None:
    planner = NavsimPlanner(Recorder(SensorConfig(cam_f0=[3])), cameras=NUPLAN_RIG)
    assert planner.camera_names == ("nuplan_f0",)
    with pytest.raises(InputError, match="camera nuplan_f0: is needed but missing"):
        _run(planner)
    with pytest.raises(InputError, match="camera cam_b0: is needed but missing; render it"):
        NavsimPlanner(Recorder(SensorConfig(cam_b0=[3])), cameras=NUPLAN_RIG)


def test_past_images_need_plans_that_fall_on_them() -> None:
    with pytest.raises(InputError, match=r"camera cam_f0: is needed every 0.5 s, but rendered"):
        _run(NavsimPlanner(Recorder(SensorConfig(cam_f0=[1]))), plan_every=3)
    agent = Recorder(SensorConfig(cam_f0=[3]))
    _run(NavsimPlanner(agent), plan_every=3)
    assert [int(seen.cameras[-1].cam_f0.image[0, 0, 0]) for seen in agent.seen] == [0, 3, 6, 9, 12]


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (SensorConfig(lidar_pc=[3]), "lidar_pc: is requested, but LiDAR is not simulated"),
        (SensorConfig(cam_f0=[4]), "sensor config, cam_f0: requests frame 4; request frames 0"),
    ],
)
def test_sensors_that_there_are_not(config: SensorConfig, message: str) -> None:
    with pytest.raises(InputError, match=f"planner my-agent: {message}"):
        NavsimPlanner(Recorder(config))


def test_what_is_no_agent() -> None:
    with pytest.raises(InputError, match="object: lacks initialize, get_sensor_config, compute_tr"):
        NavsimPlanner(object())
    agent = Recorder()
    agent.requires_scene = True  # type: ignore[attr-defined]
    with pytest.raises(InputError, match="requires_scene: is true"):
        NavsimPlanner(agent)
    with pytest.raises(InputError, match="ProbePlanner: lacks initialize"):
        make_planner("navsim:recast.planning.simple:straight")
    with pytest.raises(InputError, match="cannot be imported"):
        make_planner("navsim:no_such_module:Agent")


def _trajectory(poses: Any, interval: float = 0.5) -> Any:
    return SimpleNamespace(
        poses=poses, trajectory_sampling=SimpleNamespace(interval_length=interval)
    )


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, "returned NoneType; return a Trajectory"),
        (np.zeros((8, 3)), "returned ndarray; return a Trajectory"),
        (_trajectory(np.zeros((8, 2))), r"its poses have shape \(8, 2\)"),
        (_trajectory(np.zeros((6, 3))), "its 6 poses every 0.5 s end at 3 s, but 4 s are needed"),
        (_trajectory(np.full((8, 3), np.nan)), "pose 0 holds NaN"),
        (_trajectory([[0.0], [1.0, 2.0]]), "not an array of numbers"),
        (_trajectory(np.zeros((8, 3)), 0.0), "the interval of its poses is 0.0 s"),
    ],
)
def test_wrong_answers(answer: Any, message: str) -> None:
    with pytest.raises(InputError, match=rf"^planner my-agent: compute_trajectory: .*{message}"):
        _run(NavsimPlanner(Recorder(answer=lambda: answer)))


def test_poses_every_tenth_of_a_second_are_taken_as_they_are() -> None:
    poses = np.random.default_rng(0).normal(size=(80, 3))
    np.testing.assert_array_equal(resample(poses, 0.1, 0.1 * np.arange(1, 41)), poses[:40])


@given(st.floats(-3.0, 1.5), st.floats(0.0, 15.0), st.integers(8, 16))
def test_constant_acceleration_stays_constant(a: float, v: float, count: int) -> None:
    times, knots = 0.1 * np.arange(1, 41), 0.5 * np.arange(1, count + 1)
    poses = np.zeros((count, 3))
    poses[:, 0] = v * knots + a / 2 * knots**2
    waypoints = resample(poses, 0.5, times)
    np.testing.assert_allclose(waypoints[:, 0], v * times + a / 2 * times**2, atol=1e-9)
    np.testing.assert_array_equal(waypoints[:, 1:], 0.0)


@given(st.integers(0, 10**6))
def test_given_poses_are_met_heading_included(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses = np.cumsum(rng.normal(scale=(1.0, 0.2, 0.8), size=(8, 3)), axis=0)
    poses[:, 2] = se2.wrap_angle(poses[:, 2])
    waypoints = resample(poses, 0.5, 0.1 * np.arange(1, 41))
    np.testing.assert_allclose(waypoints[4::5, :2], poses[:, :2], atol=1e-9)
    turned = se2.wrap_angle(waypoints[4::5, 2] - poses[:, 2])
    np.testing.assert_allclose(turned, 0.0, atol=1e-9)


def test_headings_turn_the_short_way() -> None:
    poses = np.zeros((8, 3))
    poses[:, 2] = se2.wrap_angle(0.6 * np.arange(1, 9))  # passes pi
    waypoints = resample(poses, 0.5, 0.1 * np.arange(1, 41))
    steps = se2.wrap_angle(np.diff(waypoints[:, 2]))
    np.testing.assert_allclose(steps, 0.12, atol=1e-9)


def test_samplings() -> None:
    assert TrajectorySampling(time_horizon=4, interval_length=0.5).num_poses == 8
    assert TrajectorySampling(num_poses=40, interval_length=0.1).time_horizon == pytest.approx(4)
    assert TrajectorySampling(num_poses=8, time_horizon=4).interval_length == 0.5
    with pytest.raises(ValueError, match="give two"):
        TrajectorySampling(num_poses=8)
    with pytest.raises(ValueError, match=r"8 poses every 0.5 s are not 3 s"):
        TrajectorySampling(8, 3.0, 0.5)


def test_the_packages_classes_where_the_agent_uses_them(monkeypatch: pytest.MonkeyPatch) -> None:
    theirs = ModuleType("navsim.common.dataclasses")
    for name in ("AgentInput", "Camera", "Cameras", "EgoStatus", "Lidar"):
        setattr(theirs, name, type(name, (SimpleNamespace,), {}))
    monkeypatch.setitem(sys.modules, "navsim.common.dataclasses", theirs)
    agent = Recorder(SensorConfig(cam_f0=[3]))
    _run(NavsimPlanner(agent))
    seen: Any = agent.seen[0]
    assert type(seen) is theirs.AgentInput and type(seen.lidars[0]) is theirs.Lidar
    assert type(seen.cameras[-1]) is theirs.Cameras
    assert type(seen.cameras[-1].cam_f0) is type(seen.cameras[0].cam_f0) is theirs.Camera
    assert set(vars(seen.cameras[0])) == set(NAVSIM_CAMERAS)
    ours = Recorder()
    _run(NavsimPlanner(ours, installed_classes=False))
    assert type(ours.seen[0]) is AgentInput


def test_the_package_asked_for_and_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "navsim", None)
    with pytest.raises(InputError, match="navsim: package: cannot be imported"):
        NavsimPlanner(Recorder(), installed_classes=True)


def test_the_agents_speed_reaches_the_loop() -> None:
    rollout = _run(NavsimPlanner(Recorder()))
    assert rollout.planner == "my-agent"
    assert rollout.ego[-1, ego.VX] == pytest.approx(SPEED, abs=0.01)
