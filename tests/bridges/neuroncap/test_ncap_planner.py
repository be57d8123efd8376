"""A planner behind NeuroNCAP's interface: the same drive as in process, and faults in one line."""

from __future__ import annotations

import json
import multiprocessing
import pickle
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from starlette.responses import JSONResponse, Response

from recast.cameras import CameraMount, PinholeCamera
from recast.core.errors import InputError
from recast.dynamics import make_state
from recast.geometry import Polyline, se3
from recast.logs.types import Trajectory
from recast.planning import (
    ConstantVelocity,
    Plan,
    PlannerInput,
    PlanningContext,
    make_planner,
    planner_source,
)
from recast.planning.types import DrivingCommand, ReferenceRoute
from recast.simulation import MOTIONS, Rollout, RolloutSetup, run_rollout
from recast.simulation.scene_renderer import SceneRenderer
from recast_bridges.neuroncap import planner as module
from recast_bridges.neuroncap.planner import (
    NeuroNcapPlanner,
    command_of,
    infer_body,
    read_trajectory,
    waypoints_of,
)
from recast_bridges.neuroncap.service import ncap_cameras
from support.fake_neuroncap import FakePlanner, image_of, planning, rule
from support.tiny_served import BENT, CAMERA, MOVING, RIG_FROM_CAMERA, make_log, make_scene

LOG = make_log()
FRONT = {"front": CameraMount(CAMERA, RIG_FROM_CAMERA)}
RENDERER = SceneRenderer(make_scene(LOG), FRONT, "cpu")
SETUP = RolloutSetup(LOG, MOVING, MOTIONS["cut-in-a"], steps=20, camera_names=("front",))
TIMES = 0.1 * np.arange(1, 41)


@pytest.fixture
def served() -> Iterator[tuple[FakePlanner, str]]:
    with planning() as found:
        yield found


class InProcess:
    """The rule of the fake planner without anything between."""

    name, needs_images = "in-process", True

    def reset(self, context: PlanningContext) -> None:
        pass

    def plan(self, observation: PlannerInput) -> Plan:
        points = np.array(rule(observation.ego.vx, observation.images["front"]))
        return Plan(waypoints_of(points, TIMES))


def drive(planner: Any) -> Rollout:
    return run_rollout(SETUP, planner, RENDERER)


def test_a_rollout_through_the_interface_is_the_one_in_process(
    served: tuple[FakePlanner, str],
) -> None:
    fake, address = served
    outside, inside = drive(make_planner(f"neuroncap:{address}")), drive(InProcess())
    np.testing.assert_array_equal(outside.ego, inside.ego)
    np.testing.assert_array_equal(outside.predictions, inside.predictions)
    assert abs(outside.ego[-1, 1]) > 0.01  # it steered by what it saw
    assert outside.planner == "neuroncap-" + address.replace(":", "-")
    assert fake.asked == ["alive", "reset", *["infer"] * 4]
    drive(make_planner(f"neuroncap:uniad@{address}"))
    assert fake.asked[6:8] == ["alive", "reset"]


def observation(**changes: Any) -> tuple[PlannerInput, PlanningContext]:
    state = make_state([3.0, -4.0, np.pi / 2], 6.0, 0.5, 0.1)
    image = np.arange(48 * 32 * 3, dtype=np.uint8).reshape(32, 48, 3)
    seen = PlannerInput(5, 1_533_000_000_123_456, state, state[None], (), DrivingCommand.STRAIGHT,
                        {"front": image})  # fmt: skip
    line = Polyline(np.array([[0.0, 0.0], [1000.0, 0.0]]))
    route = ReferenceRoute(line, np.zeros(2), np.full(2, 8.0))
    return replace(seen, **changes), PlanningContext(route, LOG.world_from_rig, cameras=FRONT)


def test_the_body_of_infer() -> None:
    seen, context = observation()
    body = infer_body(seen, context, {"CAM_FRONT": "front"})
    np.testing.assert_array_equal(image_of(body.pop("images")["CAM_FRONT"]), seen.images["front"])
    half = np.sqrt(0.5)
    body["canbus"] = [round(number, 12) for number in body["canbus"]]
    rounded = json.loads(json.dumps(body), parse_float=lambda text: round(float(text), 12))
    assert rounded == {
        "ego2world": [[0, -1, 0, 3], [1, 0, 0, -4], [0, 0, 1, 0], [0, 0, 0, 1]],
        "canbus": [
            3, -4, 0, round(half, 12), 0, 0, round(half, 12), 0.5, 0.6, 9.8, 0, 0, 0.1, 6, 0, 0
        ],
        "timestamp": 1_533_000_000_123_456,
        "command": 2,
        "calibration": {
            "camera2image": {"CAM_FRONT": [[30, 0, 23.5], [0, 30, 15.5], [0, 0, 1]]},
            "camera2ego": {
                "CAM_FRONT": [[0, 0, 1, 1.5], [-1, 0, 0, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]]
            },
            "lidar2ego": [[0, 1, 0, 0.94], [-1, 0, 0, 0], [0, 0, 1, 1.84], [0, 0, 0, 1]],
        },
    }  # fmt: skip


@pytest.mark.parametrize(
    ("left", "speed", "command"),
    [(0.0, 8.0, 2), (2.1, 8.0, 0), (-2.1, 8.0, 1), (1.9, 8.0, 2), (-1.9, 8.0, 2), (-3.0, 0.0, 1)],
)
def test_the_command_is_by_the_route_beside_where_the_ego_will_be(
    left: float, speed: float, command: int
) -> None:
    _, context = observation()
    assert command_of(context.route, make_state([50.0, left, 0.0], speed)) == command


def test_the_command_before_a_bend() -> None:
    """Nothing to the side yet, but where straight on would lead in 3 s there is."""
    angle = np.linspace(0.0, np.pi / 2, 200)
    bend = 20.0 * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=-1)
    poses = se3.from_rotation_translation(np.eye(3), np.pad(bend, ((0, 0), (0, 1))))
    times = 50_000 * np.arange(200, dtype=np.int64)
    route = ReferenceRoute.from_trajectory(Trajectory(times, poses))
    assert command_of(route, make_state([0.0, 0.0, 0.0], 6.0)) == 1
    assert command_of(route, make_state([0.0, 0.0, 0.0], 2.0)) == 2


def rig(**yaws: float) -> dict[str, CameraMount]:
    turn = {name: se3.rotation_z(np.deg2rad(yaw)) for name, yaw in yaws.items()}
    wide = PinholeCamera(160, 90, 120.0, 120.0, 80.0, 45.0)
    return {
        name: CameraMount(
            wide, se3.from_rotation_translation(one @ RIG_FROM_CAMERA[:3, :3], np.zeros(3))
        )
        for name, one in turn.items()
    }


def test_cameras_are_found_by_name_then_by_direction() -> None:
    rear = rig(a=0, b=50, c=-60, d=175, e=105, f=-112, g=20)
    assert ncap_cameras(rear) == {
        "CAM_FRONT": "a", "CAM_FRONT_LEFT": "b", "CAM_FRONT_RIGHT": "c", "CAM_BACK": "d",
        "CAM_BACK_LEFT": "e", "CAM_BACK_RIGHT": "f",
    }  # fmt: skip
    assert ncap_cameras(rig(CAM_FRONT=10, other=0)) == {"CAM_FRONT": "CAM_FRONT"}
    bent = {"bent": CameraMount(BENT, RIG_FROM_CAMERA)}
    with pytest.raises(InputError, match="CAM_FRONT: no camera of the log corresponds to it"):
        make_planner("neuroncap:127.0.0.1:9000").choose_cameras({**bent, **rig(d=180)})


def test_constant_velocity_is_that_of_recast() -> None:
    seen, _ = observation()
    straight = waypoints_of(np.outer(0.5 * np.arange(1, 7), [6.0, 0.0]), TIMES)
    # Sums and products of numbers up to 24, a dozen roundings.
    bound = 24 * 12 * np.finfo(float).eps
    wanted = ConstantVelocity().plan(seen).waypoints
    np.testing.assert_allclose(straight, wanted, rtol=0, atol=bound)


def test_waypoints_meet_the_points_and_their_direction() -> None:
    s = 8.0 * 0.5 * np.arange(1, 7)
    circle = np.stack([50 * np.sin(s / 50), 50 * (1 - np.cos(s / 50))], axis=-1)
    found = waypoints_of(circle, TIMES)
    np.testing.assert_allclose(found[4:30:5, :2], circle, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found[9:25, 2], 8.0 * TIMES[9:25] / 50, atol=0.02)
    steps = np.diff(found[29:, :2], axis=0)  # after the last point
    np.testing.assert_allclose(steps, np.tile(steps[0], (len(steps), 1)), rtol=0, atol=1e-12)


def test_a_plan_that_stops_does_not_overshoot_or_turn() -> None:
    stop = np.array([[3.0, 0.0], [4.0, 0.0], *[[4.0, 0.0]] * 4])
    found = waypoints_of(stop, TIMES)
    assert found[:, 0].max() == 4.0 and np.all(np.diff(found[:, 0]) >= 0)
    assert not found[:, 1:].any()
    assert not waypoints_of(np.zeros((6, 2)), TIMES).any()


def test_a_plan_that_goes_back_is_driven_backwards() -> None:
    back = waypoints_of(np.outer(np.arange(1, 7), [-1.0, -0.1]), TIMES)
    np.testing.assert_allclose(back[:, 2], np.arctan(0.1), atol=1e-12)


TOO_SHORT = "trajectory has 5 points, expected 6 to 100 points"


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        ({"trajectory": [[1.0, 0.0]] * 5}, TOO_SHORT),
        ({"trajectory": []}, "trajectory has 0 points"),
        ({"trajectory": None}, "trajectory is not a list"),
        ({"aux_outputs": {}}, "trajectory is missing"),
        ([[1.0, 0.0]] * 6, "trajectory is missing"),
        ({"trajectory": [[1.0, 0.0]] * 5 + [[1.0, 0.0, 0.0]]}, r"trajectory\[5\] is \[1.0, 0.0, 0"),
        ({"trajectory": [[1.0, "0"]] * 6}, r"trajectory\[0\] is \[1.0, '0'\]"),
        ({"trajectory": [[1.0, True]] * 6}, r"trajectory\[0\]"),
        ({"trajectory": [1.0] * 6}, r"trajectory\[0\] is 1.0"),
        ({"trajectory": [[1e5, 0.0]] * 6}, r"trajectory\[0\]"),
        ({"trajectory": [[0.0, float("nan")]] * 6}, r"trajectory\[0\]"),
    ],
)
def test_what_is_no_trajectory(answer: object, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        read_trajectory(answer)


def failing(fake: FakePlanner, address: str) -> str:
    with pytest.raises(InputError) as error:
        drive(make_planner(f"neuroncap:{address}"))
    line = str(error.value)
    assert "\n" not in line and line.startswith(f"planner neuroncap:{address}: /")
    return line


def test_faults_of_the_program_are_one_line(
    served: tuple[FakePlanner, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fake, address = served

    def empty(body: Mapping[str, Any]) -> Response:
        return JSONResponse({"trajectory": [], "aux_outputs": {}})

    def broken(body: Mapping[str, Any]) -> Response:
        return Response("CUDA out of memory", 500)

    def slow(body: Mapping[str, Any]) -> Response:
        time.sleep(1.0)
        return fake.drive(body)

    fake.answer = empty
    assert "/infer: gave an invalid answer: trajectory has 0 points" in failing(fake, address)
    fake.answer = broken
    assert "answered 500 Internal Server Error: CUDA out of memory" in failing(fake, address)
    fake.answer = lambda body: Response("NaN")
    assert "/infer: its answer cannot be read (NaN is not a number that JSON allows)" in failing(
        fake, address
    )
    monkeypatch.setattr(module, "INFER_S", 0.2)
    fake.answer = slow
    assert "/infer: has not answered within 0.2 s" in failing(fake, address)


def test_nobody_there(monkeypatch: pytest.MonkeyPatch) -> None:
    with planning() as (_, address):
        pass
    monkeypatch.setattr(module, "ALIVE_S", 0.3)
    assert "/alive: no program listens there" in failing(FakePlanner(), address)


def test_a_program_that_comes_late_is_waited_for(
    served: tuple[FakePlanner, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fake, address = served
    planner = make_planner(f"neuroncap:{address}")
    sent, tries = planner._service.send, []

    class Late:
        def send(self, method: Any, path: str, *rest: Any, **limits: Any) -> bytes:
            tries.append(path)
            if len(tries) < 3:
                raise InputError("planner", path, "no program listens there", "start it")
            return sent(method, path, *rest, **limits)

    monkeypatch.setattr(planner, "_service", Late())
    planner.reset(observation()[1])
    assert tries == ["/alive"] * 3 + ["/reset"] and fake.asked == ["alive", "reset"]


def _plan_elsewhere(planner: NeuroNcapPlanner, answers: Any) -> None:
    seen, context = observation()
    planner.reset(context)
    answers.put(planner.plan(seen).waypoints.tolist())


def test_it_plans_in_a_process_that_was_forked_off(served: tuple[FakePlanner, str]) -> None:
    _, address = served
    planner = make_planner(f"neuroncap:{address}")
    seen, context = observation()
    planner.reset(context)
    here = planner.plan(seen).waypoints.tolist()
    processes = multiprocessing.get_context("fork")
    answers = processes.Queue()
    child = processes.Process(target=_plan_elsewhere, args=(planner, answers))
    child.start()
    assert answers.get(timeout=60) == here
    child.join(60)
    assert pickle.loads(pickle.dumps(planner)).name == planner.name


@pytest.mark.parametrize(
    ("word", "problem"),
    [
        ("neuroncap:", "is not an address; give HOST:PORT"),
        ("neuroncap:localhost", "is not an address; give HOST:PORT"),
        ("neuroncap:a b@localhost:1", "label: is 'a b'; use letters"),
        ("neuroncap:@localhost:1", "label: is ''; use letters"),
    ],
)
def test_words_that_name_no_program(word: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        make_planner(word)


def test_the_word_is_what_stands_for_it_in_keys() -> None:
    assert planner_source("neuroncap:uniad@localhost:9000") == "neuroncap:uniad@localhost:9000"
    assert make_planner("neuroncap:uniad@localhost:9000").name == "uniad"
