from __future__ import annotations

import pickle
import subprocess
import sys
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

from recast.cameras import CameraMount, PinholeCamera
from recast.core.errors import InputError
from recast.dynamics import state as ego
from recast.envs import ENV_ID, DrivingEnv, ProgressReward
from recast.envs.driving_env import ACTOR_COLUMNS
from recast.geometry import se2
from recast.logs import write_log
from recast.logs.hdmap import HdMap
from recast.planning import ConstantVelocity
from recast.simulation import (
    MOTIONS,
    Idm,
    NullRenderer,
    PerfectController,
    RolloutSettings,
    RolloutSetup,
    run_rollout,
)
from support.synthetic_drives import drive

ACTORS = {"7": "cut-in-a"}
MOUNTS = {
    "front": CameraMount(PinholeCamera(8, 4, 5.0, 5.0, 4.0, 2.0), np.eye(4)),
    "left": CameraMount(PinholeCamera(6, 4, 5.0, 5.0, 3.0, 2.0), np.eye(4)),
}


def env_of(steps: int = 20, **arguments) -> DrivingEnv:
    settings = RolloutSettings(steps=steps)
    return DrivingEnv(drive(), **{"actors": ACTORS, "settings": settings, **arguments})


def straight(speed: float) -> np.ndarray:
    waypoints = np.zeros((40, 3), np.float32)
    waypoints[:, 0] = speed * 0.1 * np.arange(1, 41)
    return waypoints


def keep_speed(observation: dict) -> np.ndarray:
    """A planner that knows nothing but the observation."""
    return straight(float(observation["ego"][ego.VX]))


@pytest.mark.parametrize("action", ["waypoints", "controls"])
@pytest.mark.parametrize("cameras", [False, True])
def test_gymnasium_s_own_check(action: str, cameras: bool) -> None:
    scene = NullRenderer(MOUNTS) if cameras else None
    env = gymnasium.make(
        ENV_ID,
        log=drive(),
        scene=scene,
        actors={"7": "cut-in-a", "9": "log-replay"},
        action=action,
        settings=RolloutSettings(steps=20),
        render_mode="rgb_array" if cameras else None,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for advice in ("Box", "render_mode", "symmetric"):  # bounds are a matter of taste
            warnings.filterwarnings("ignore", message=f".*{advice}")
        check_env(env.unwrapped)
    env.close()


def test_the_id_is_found_by_its_package() -> None:
    env = gymnasium.make(
        f"recast.envs:{ENV_ID}", log=drive(), actors=ACTORS, settings=RolloutSettings(steps=10)
    )
    assert isinstance(env.unwrapped, DrivingEnv)


def test_an_agent_drives_as_a_planner_does() -> None:
    env = env_of(terminate=())
    observation, _ = env.reset(seed=1)
    over = False
    while not over:
        observation, _, terminated, truncated, _ = env.step(keep_speed(observation))
        over = terminated or truncated
    setup = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], steps=20)
    planned = run_rollout(setup, ConstantVelocity())
    # float32 waypoints: less than a millimetre
    np.testing.assert_allclose(env.rollout.ego, planned.ego, atol=1e-4)
    np.testing.assert_array_equal(env.rollout.actor, planned.actor)


def test_what_the_agent_sees_is_in_its_own_frame() -> None:
    for pose in ((0.0, 0.0, 0.0), (200.0, -50.0, 2.2)):
        log = drive(curvature=0.015, world_from_start=pose)
        env = DrivingEnv(
            log,
            actors={"7": "cut-in-a"},
            most_actors=4,
            settings=RolloutSettings(traffic="replay"),
        )
        env.reset(seed=0)
        seen, *_ = env.step(straight(8.0))
        assert seen in env.observation_space
        np.testing.assert_array_equal(seen["ego"][ego.POSE], 0.0)
        assert seen["ego"][ego.VX] == pytest.approx(env.simulator.state.ego.vx, rel=1e-6)
        assert seen["history"].shape == (21, 11)
        assert np.all(np.diff(seen["history"][-6:, 0]) > 0.0)
        np.testing.assert_array_equal(seen["history"][0], seen["history"][14])  # none before
        assert seen["route"].shape == (20, 2)
        steps = np.linalg.norm(np.diff(seen["route"], axis=0), axis=1)
        np.testing.assert_allclose(steps, 2.5, atol=0.01)
        assert seen["command"] == 0  # left
        assert seen["actors_mask"].tolist() == [1, 1, 0, 0]
        row = dict(zip(ACTOR_COLUMNS, seen["actors"][0], strict=True))
        state = env.simulator.state
        expected = se2.relative(state.ego.pose, state.actor[:3])
        assert [row["x"], row["y"], row["heading"]] == pytest.approx(expected.tolist(), abs=1e-4)
        assert np.hypot(row["vx"], row["vy"]) == pytest.approx(state.actor[3], rel=1e-5)
        assert (row["length"], row["width"], row["height"]) == pytest.approx((4.2, 1.8, 1.5))
        np.testing.assert_array_equal(seen["actors"][2:], 0.0)


def test_images_are_of_the_named_cameras() -> None:
    env = env_of(scene=NullRenderer(MOUNTS), cameras=["left"])
    observation, _ = env.reset()
    assert set(observation["images"]) == {"left"}
    assert observation["images"]["left"].shape == (4, 6, 3)
    assert "images" not in env_of().reset()[0]
    shown = env_of(scene=NullRenderer(MOUNTS), render_mode="rgb_array")
    shown.reset()
    assert shown.render().shape == (4, 14, 3)
    shown.close()


def test_a_collision_terminates_if_asked_for() -> None:
    def drive_on(**settings) -> tuple[int, bool, float, dict]:
        env = env_of(actors={"7": "stationary-a"}, steps=60, **settings)
        env.reset(seed=0)
        for count in range(1, 100):
            _, reward, terminated, truncated, info = env.step(straight(10.0))
            if terminated or truncated:
                assert info["metrics"]["nc"] == 0.0
                with pytest.raises(InputError, match="the episode is over; call reset"):
                    env.step(straight(10.0))
                return count, terminated, reward, info
        raise AssertionError

    early, terminated, reward, info = drive_on()
    assert terminated and info["ending"] == "terminated"
    assert info["collision"] and info["overlap"] > 0.0
    assert reward == pytest.approx(info["progress"] - 10.0)
    assert info["reward_parts"]["collision"] == -10.0
    late, terminated, _, info = drive_on(terminate=("off_road",))
    assert early < late == 12 and not terminated and info["ending"] == "steps"


def test_leaving_the_road_terminates_if_there_is_a_map() -> None:
    area = np.array([[-20.0, -3.0], [300.0, -3.0], [300.0, 6.0], [-20.0, 6.0]])
    settings = RolloutSettings(map=HdMap({}, (area,)), steps=100)
    env = env_of(settings=settings, action="controls")
    env.reset(seed=0)
    for _ in range(20):
        _, _, terminated, _, info = env.step(np.array([0.0, -0.05], np.float32))
        if terminated:
            break
    assert info["off_road"] and info["off_road_distance"] > 0.3 and not info["collision"]


def test_the_end_of_the_route_terminates_and_the_log_s_end_truncates() -> None:
    env = DrivingEnv(drive(speed=5.0, seconds=12), actors={"7": "stationary-a"}, terminate=())
    env.reset(seed=0)
    over = terminated = truncated = False
    while not over:
        _, _, terminated, truncated, info = env.step(straight(14.0))
        over = terminated or truncated
    assert terminated and not truncated and info["route_end"] and info["ending"] == "ego"
    env.reset(seed=0)
    over = False
    while not over:
        _, _, terminated, truncated, info = env.step(straight(2.0))
        over = terminated or truncated
    assert truncated and not terminated and info["ending"] == "log"
    assert info["cut_reason"] == "the log ends 12.0 s after the start"


def test_the_same_seed_gives_the_same_bytes() -> None:
    def run(seed: int) -> list[bytes]:
        env = env_of(actors={"7": "cut-in-a", "9": Idm("a", gap=60.0)})
        env.action_space.seed(seed)
        observation, _ = env.reset(seed=seed)
        seen = [observation["history"].tobytes()]
        over = False
        while not over:
            action = straight(8.0) + 0.01 * env.action_space.sample()
            observation, reward, terminated, truncated, _ = env.step(action)
            seen += [observation[k].tobytes() for k in ("ego", "history", "route", "actors")]
            seen.append(np.float64(reward).tobytes())
            over = terminated or truncated
        return seen

    assert run(3) == run(3) != run(4)


def test_options_change_an_episode() -> None:
    env = env_of()
    env.reset(options={"scenario": "stationary-a", "start_timestamp_us": 6_000_000})
    assert env.simulator.state.actor[3] == 0.0
    assert env.simulator.state.timestamp_us == 6_000_000
    env.reset(options={"actors": {"9": "idm-b", "7": "advancing"}})
    assert list(env.simulator.state.actors) == ["9", "7"]
    env.reset()
    assert env.simulator.setup.motion == MOTIONS["cut-in-a"]
    with pytest.raises(InputError, match="option scene: is not known; choose one of scenario"):
        env.reset(options={"scene": 1})


def test_controls_accelerate_steer_and_never_reverse() -> None:
    env = env_of(action="controls", steps=80, actors={"7": "advancing-b"}, terminate=())
    env.reset(seed=0)
    _, _, _, _, info = env.step(np.array([2.4, 0.1], np.float32))
    assert info["speed"] > 10.5 and env.simulator.state.ego.steering_angle > 0.0
    for _ in range(15):
        _, _, _, _, info = env.step(np.array([-9.0, 0.0], np.float32))  # clipped to -4.05
    assert info["speed"] == 0.0
    assert env.rollout.ego[:, ego.VX].min() == 0.0
    assert env.rollout.ego[:, ego.AX].min() >= -4.06
    # the plan beside it is where the command leads
    again = env_of(action="controls", steps=40)
    again.reset(seed=0)
    again.step(np.array([1.0, 0.05], np.float32))
    rollout = again.rollout
    driven = se2.relative(rollout.ego[0, :3], rollout.ego[1:6, :3])
    np.testing.assert_allclose(rollout.predictions[0, :5], driven, atol=1e-9)


def test_a_reward_of_one_s_own() -> None:
    env = env_of(reward=lambda facts: facts.speed)
    env.reset(seed=0)
    _, reward, _, _, info = env.step(straight(9.0))
    assert reward == info["speed"]
    assert info["reward_parts"] == {}
    heavier = env_of(reward=ProgressReward(progress=2.0))
    heavier.reset(seed=0)
    _, reward, *_, info = heavier.step(straight(9.0))
    assert reward == pytest.approx(2.0 * info["progress"])


@pytest.mark.parametrize(
    ("kind", "action", "message"),
    [
        ("waypoints", np.zeros((8, 3)), r"has the shape \(8, 3\); give waypoints \(40, 3\)"),
        ("waypoints", np.full((40, 3), np.nan), r"is NaN or infinite at \[0, 0\]"),
        ("waypoints", "no", "is not an array of numbers"),
        ("waypoints", None, "has the shape|is NaN|no array"),
        ("controls", np.zeros(3), r"has the shape \(3,\); give controls \(2,\)"),
        ("controls", np.array([0.0, np.inf]), r"is NaN or infinite at \[1\]"),
        ("controls", [[1.0], [1.0, 2.0]], "is not an array of numbers"),
    ],
)
def test_a_bad_action_is_one_line_and_moves_nothing(
    kind: str, action: object, message: str
) -> None:
    env = env_of(action=kind)
    env.reset(seed=0)
    with pytest.raises(InputError, match=f"DrivingEnv: action: ({message})") as error:
        env.step(action)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)
    assert env.simulator.step_number == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"action": "steer"}, "action: is 'steer'; choose one of waypoints, controls"),
        (
            {"terminate": "collision"},
            "terminate: is 'collision'; give a list of names from collision, off_road",
        ),
        ({"terminate": ("crash",)}, r"terminate: is \('crash',\)"),
        ({"most_actors": 0}, "most_actors: is 0; give 1 to 1000"),
        ({"render_mode": "human"}, "render_mode: is 'human'"),
        ({"render_mode": "rgb_array"}, "render_mode: needs cameras; give a scene"),
        (
            {"action": "controls", "settings": RolloutSettings(controller=PerfectController())},
            "controller: is PerfectController.*; leave it out",
        ),
        ({"actors": {}}, "actors: is empty"),
        ({"log": "no/such/log"}, "no/such/log"),
        ({"scene": "no/such/scene"}, "no/such/scene"),
    ],
)
def test_bad_arguments_are_one_line(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        DrivingEnv(**{"log": drive(), "actors": ACTORS, **arguments})  # type: ignore[arg-type]
    assert "\n" not in str(error.value)


def test_before_a_reset_nothing_steps() -> None:
    with pytest.raises(InputError, match="call reset"):
        env_of().step(straight(1.0))


@pytest.mark.parametrize("processes", [False, pytest.param(True, marks=pytest.mark.whole)])
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_several_at_once_and_in_processes_of_their_own(processes: bool, tmp_path: Path) -> None:
    """Each loads the log itself; agents here drive them by observations alone."""
    log = replace(drive(seconds=8), cameras={})
    write_log(log, tmp_path / "log")
    names = ("cut-in-a", "advancing-a", "stationary-a", "oncoming-a")
    makers = [
        partial(
            DrivingEnv,
            str(tmp_path / "log"),
            actors={"7": name},
            settings=RolloutSettings(steps=30),
            terminate=(),
        )
        for name in names
    ]
    if processes:
        envs = AsyncVectorEnv(makers, context="spawn")
    else:
        envs = SyncVectorEnv(pickle.loads(pickle.dumps(makers)))
    try:
        observation, _ = envs.reset(seed=5)
        assert observation["ego"].shape == (4, 11)
        progress = np.zeros(4)
        for _ in range(6):
            actions = np.stack([straight(float(v)) for v in observation["ego"][:, ego.VX]])
            observation, _, terminated, truncated, info = envs.step(actions)
            progress += info["progress"]
        assert truncated.all() and not terminated.any()
    finally:
        envs.close()
    for name, metres in zip(names, progress, strict=True):
        setup = RolloutSetup(log, "7", MOTIONS[name], steps=30)
        alone = run_rollout(setup, ConstantVelocity()).ego
        assert metres == pytest.approx(alone[-1, 0] - alone[0, 0], abs=1e-3)


def test_without_gymnasium_the_line_says_what_to_install() -> None:
    code = "import sys; sys.modules['gymnasium'] = None; import recast.envs"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    last = done.stderr.strip().splitlines()[-1]
    assert last.endswith(
        "InputError: recast.envs: gymnasium: is not installed; pip install 'recast-sim[env]'"
    )


def test_the_default_action_passes_gymnasium_s_check_and_frames_follow_the_steps() -> None:
    env = DrivingEnv(
        drive(), actors={"7": "cut-in-a"}, settings=RolloutSettings(steps=10, plan_every=2)
    )
    assert env.metadata["render_fps"] == pytest.approx(5.0)
    env.reset(seed=0)
    over, info = False, {}
    while not over:
        _, _, terminated, truncated, info = env.step(env.action_space.sample() * 0)
        over = terminated or truncated
    assert info["metrics"] and all(np.isfinite(v) for v in info["metrics"].values())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env, skip_render_check=True)
