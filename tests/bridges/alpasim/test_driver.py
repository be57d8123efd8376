"""A driver over a channel: the same rollout as its rule in process; the planner by its word."""

from __future__ import annotations

import multiprocessing
import pickle
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pytest

from recast.arrays import Image
from recast.core.errors import InputError
from recast.geometry import se2
from recast.planning import (
    LogReplay,
    Plan,
    PlannerInput,
    PlanningContext,
    camera_choice,
    make_planner,
    seen_lines,
    seen_record,
    virtual_mounts,
)
from recast.simulation import (
    MOTIONS,
    NullRenderer,
    RoadSurface,
    RolloutSetup,
    probe_path,
    run_rollout,
)
from recast_bridges.alpasim.driver import AlpaSimDriver, driver_planner
from recast_bridges.alpasim.messages import as_sent, message
from support.driven import Noise, planner_of, setup_of
from support.fake_driver import VERSION, FakeDriver, driving, follow
from support.synthetic_drives import drive
from support.tiny_served import MOUNTS, MOVING, make_log


class InProcess:
    """The rule of the driver as a planner, with numbers as the messages hold them: float32."""

    name = "in-process"

    def __init__(self, cameras: Sequence[str], suffix: str) -> None:
        self.camera_names, self.needs_images, self._suffix = tuple(cameras), bool(cameras), suffix

    def reset(self, context: PlanningContext) -> None:
        self._route = context.route
        ground = None if context.map is None else context.map.ground
        self._surface = RoadSurface.from_log(context.log, context.route, ground)

    def plan(self, observation: PlannerInput) -> Plan:
        now = observation.ego.pose
        s = max(float(self._route.project(now)[0]), 0.0)
        route = np.full((20, 3), np.nan)
        for index in range(20):
            ahead = s + index * 80.0 / 19.0
            if ahead <= self._route.length:
                route[index] = [*se2.relative(now, self._route.pose(ahead))[:2], 0.0]
        images = {name: self._sent(observation.images[name]) for name in self.camera_names}
        planned = follow(
            as_sent(self._surface.ego_poses(now)),
            float(np.float32(observation.ego.vx)),
            route.astype(np.float32).astype(np.float64),
            images,
        )
        poses = np.stack([as_sent(pose) for pose in planned])
        return Plan(se2.relative(now, se2.from_se3(poses))[1:])

    def _sent(self, image: Image) -> Image:
        data = cv2.imencode(self._suffix, image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        return cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]


@pytest.mark.parametrize(
    ("cameras", "image_format", "suffix"),
    [((), "jpeg", ".jpg"), (("front", "bent"), "jpeg", ".jpg"), (("front",), "png", ".png")],
)
@pytest.mark.parametrize(("curvature", "slope"), [(0.0, 0.0), (0.01, 0.05), (-0.012, 0.0)])
def test_a_rollout_over_the_channel_is_the_one_in_process(
    cameras: tuple[str, ...], image_format: Any, suffix: str, curvature: float, slope: float
) -> None:
    log = drive(curvature=curvature, slope=slope, world_from_start=(30.0, -20.0, 0.7))
    setup, renderer = setup_of(log), Noise(MOUNTS) if cameras else None
    inside = run_rollout(setup, InProcess(cameras, suffix), renderer)
    driver = FakeDriver()
    with driving(driver) as port:
        planner = planner_of(port, cameras, image_format=image_format)
        outside = run_rollout(setup, planner, renderer)
    assert driver.refused == [] and driver.sessions == {}
    assert outside.ego.tobytes() == inside.ego.tobytes()
    assert outside.predictions.tobytes() == inside.predictions.tobytes()
    assert outside.steps_run == 30 and outside.ego[-1, 3] != outside.ego[0, 3]
    wanted = ["get_version", "start_session"]
    for _ in range(6):
        wanted += ["submit_image_observation"] * len(cameras)
        wanted += ["submit_egomotion_observation", "submit_route", "drive"]
    assert driver.calls == [*wanted, "close_session"]


def test_frames_are_right() -> None:
    """Over the empty plane, without images: left is left."""

    def left(local_from_rig: np.ndarray, speed: float, *seen: object) -> list[np.ndarray]:
        return follow(local_from_rig, speed, np.array([[12.0, 2.0, 0.0], [15.0, 3.0, 0.0]]), {})

    driver = FakeDriver(rule=left)
    with driving(driver) as port:
        x, y, heading = probe_path(planner_of(port))[-1]
    assert driver.refused == []
    assert x > 25.0 and y > 5.0 and heading > 0.4


@pytest.mark.parametrize("left", [0.0, 0.4])
def test_the_driver_is_told_the_past_and_a_route_that_ends(left: float) -> None:
    log = drive(seconds=11.0)
    driver = FakeDriver()
    with driving(driver) as port:
        setup = setup_of(log, 20, start_timestamp_us=9_000_000, start_left=left)
        run_rollout(setup, planner_of(port, seed=7))
    assert driver.refused == [] and driver.told[1].random_seed == 7
    motion = [one for one in driver.told if hasattr(one, "dynamic_states")]
    times = [pose.timestamp_us for one in motion for pose in one.trajectory.poses]
    assert times == list(range(5_000_000, 10_500_001, 100_000))  # from the start of the log on
    assert [len(one.trajectory.poses) for one in motion] == [41, 5, 5, 5]
    aside = [pose.pose.vec.y for pose in motion[0].trajectory.poses]
    np.testing.assert_allclose(aside, left, rtol=0, atol=1e-7)
    routes = [one.route for one in driver.told if hasattr(one, "route")]
    assert [int(np.isfinite([p.x for p in route.waypoints]).sum()) for route in routes] == [
        *(17, 16, 15, 14)  # 70 m are left, and 5 m less each time; points are 80 / 19 m apart
    ]


def test_sessions_of_several_rollouts_do_not_mix() -> None:
    driver = FakeDriver(["front"])
    with driving(driver) as port, planner_of(port, ["front"]) as planner:
        first = run_rollout(setup_of(), planner, Noise(MOUNTS))
        again = run_rollout(setup_of(), planner, Noise(MOUNTS))
        planner.reset(context_of(planner))
        assert len(driver.sessions) == 1
        planner.reset(context_of(planner))
        assert len(driver.sessions) == 1  # the one before was closed
    assert driver.sessions == {}
    assert first.ego.tobytes() == again.ego.tobytes()
    assert len(driver.drives) == 4


def context_of(planner: AlpaSimDriver) -> PlanningContext:
    """What `run_rollout` would reset the planner with."""
    caught: list[PlanningContext] = []

    class Catching(LogReplay):
        def reset(self, context: PlanningContext) -> None:
            caught.append(context)
            super().reset(context)

    catching = Catching()
    catching.needs_images, catching.camera_names = True, planner.camera_names
    run_rollout(setup_of(), catching, NullRenderer(MOUNTS))
    return caught[0]


def test_without_names_all_rendered_cameras_are_sent() -> None:
    driver = FakeDriver()
    log = make_log()
    setup = RolloutSetup(log, MOVING, MOTIONS["advancing-a"], steps=20, camera_names=("front",))
    with driving(driver) as port:
        run_rollout(setup, planner_of(port, None), Noise(MOUNTS))
        run_rollout(RolloutSetup(log, MOVING, MOTIONS["advancing-a"], steps=20),
                    planner_of(port, None), Noise(MOUNTS))  # fmt: skip
    sent = [one.camera_image.logical_id for one in driver.told if hasattr(one, "camera_image")]
    assert sent == ["front"] * 4 + ["front", "bent"] * 4


# The planner by its word


@pytest.mark.parametrize(
    ("words", "cameras", "looks"),
    [
        ("localhost:6789", None, True),
        ("[::1]:6789/", (), False),
        ("host:1/a,b", ("a", "b"), True),
        ("host:1/CAM_F0=nuplan_f0,b", ("nuplan_f0", "b"), True),
    ],
)
def test_words(words: str, cameras: tuple[str, ...] | None, looks: bool) -> None:
    planner = make_planner(f"alpasim:{words}", "cpu")
    assert isinstance(planner, AlpaSimDriver)
    assert planner.name == f"alpasim:{words}"
    assert planner.address == words.partition("/")[0]
    assert (planner.camera_names, planner.needs_images) == (cameras, looks)


def test_nuplan_s_cameras_are_rendered_for_a_driver_that_wants_them() -> None:
    planner = make_planner("alpasim:host:1/CAM_F0=nuplan_f0")
    mounts = MOUNTS | virtual_mounts(planner, MOUNTS)
    assert camera_choice(planner, mounts) == {"CAM_F0": "nuplan_f0"}
    assert not mounts["nuplan_f0"].camera.is_rectified


@pytest.mark.parametrize("words", ["", "host", ":1", "host:x", "host:0", "host:70000", "host:1²"])
def test_words_without_host_and_port(words: str) -> None:
    with pytest.raises(InputError, match="does not name a host and a port; give alpasim:HOST:PORT"):
        driver_planner(words)


@pytest.mark.parametrize("words", ["h:1/,", "h:1/a,a", "h:1/a=", "h:1/=b"])
def test_words_with_faulty_cameras(words: str) -> None:
    with pytest.raises(
        InputError, match=r"is empty or appears twice; give names separated by commas"
    ):
        make_planner(f"alpasim:{words}")


def test_records_name_the_driver_and_its_version() -> None:
    with driving(FakeDriver()) as port:
        planner = planner_of(port, ["front"], name="mine")
        run_rollout(setup_of(), planner, Noise(MOUNTS))
        record, (said, _) = seen_record(planner, MOUNTS), seen_lines(planner, MOUNTS)
    assert record["planner"] == "mine"
    assert record["driver"] == f"{VERSION}, git abc, API 0.54.0"
    assert record["log_drove_s"] == 0.0
    assert said == f"planner mine, driver {VERSION}, git abc, API 0.54.0 sees front"


@pytest.mark.parametrize(
    ("fields", "wanted"),
    [
        ({}, "unnamed"),
        ({"version_id": "vam"}, "vam"),
        ({"grpc_api_version": message("ApiVersion")}, "unnamed, API 0.0.0"),
        ({"version_id": "vam", "git_hash": "12ab"}, "vam, git 12ab"),
    ],
)
def test_a_driver_may_say_little_of_its_version(fields: Any, wanted: str) -> None:
    class Quiet(FakeDriver):
        def get_version(self, request: Any) -> Any:
            return message("VersionId", **fields)

    with driving(Quiet()) as port:
        assert planner_of(port).version == wanted


IN_A_CHILD = """
import os, sys
from recast.planning import make_planner
from recast.simulation import probe_path
planner = make_planner("alpasim:127.0.0.1:%d/")
assert not {"grpc", "torch"} & set(sys.modules), "made too early"
child = os.fork()
line = "%%s %%s\\n" %% (child == 0, probe_path(planner)[-1].tobytes().hex())
os.write(1, line.encode())  # whole: print writes in pieces where PYTHONUNBUFFERED is set
if child:
    assert os.waitpid(child, 0)[1] == 0
os._exit(0)
"""


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="no fork here")
def test_a_planner_is_made_before_a_fork_and_drives_on_both_sides() -> None:
    driver = FakeDriver()
    with driving(driver) as port:
        done = subprocess.run(
            [sys.executable, "-c", IN_A_CHILD % port], capture_output=True, text=True, timeout=120
        )
    assert done.returncode == 0, done.stderr
    lines = sorted(line.split() for line in done.stdout.splitlines())
    assert [line[0] for line in lines] == ["False", "True"]
    assert lines[0][1] == lines[1][1]
    assert len(driver.drives) == 2 and driver.sessions == {} and driver.refused == []


def _drive(planner: AlpaSimDriver) -> bytes:
    return probe_path(planner).tobytes()


def test_a_planner_goes_to_other_processes() -> None:
    with driving(FakeDriver()) as port:
        planner = pickle.loads(pickle.dumps(planner_of(port)))
        here = _drive(planner)
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            assert pool.map(_drive, [planner] * 2) == [here] * 2
