"""A driver over a channel: the same rollout as its rule in process, and faults of either side."""

from __future__ import annotations

import multiprocessing
import pickle
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import Any

import cv2
import numpy as np
import pytest
from google.protobuf.message import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.arrays import Image
from recast.core.errors import InputError
from recast.geometry import se2
from recast.logs.types import DrivingLog
from recast.planning import (
    LogReplay,
    Plan,
    PlannerInput,
    PlanningContext,
    camera_choice,
    make_planner,
    planner_source_files,
    seen_lines,
    seen_record,
    virtual_mounts,
)
from recast.protocols.alpasim import driver_session as module
from recast.protocols.alpasim.driven_plan import DrivenPlan
from recast.protocols.alpasim.driver import AlpaSimDriver, driver_planner
from recast.protocols.alpasim.messages import message, parse
from recast.protocols.alpasim.poses import as_sent, pose_message
from recast.simulation import (
    MOTIONS,
    NullRenderer,
    RoadSurface,
    Rollout,
    RolloutFailure,
    RolloutJob,
    RolloutSetup,
    SimState,
    probe_path,
    run_batch,
    run_rollout,
)
from recast.simulation.renderer import Mounted
from simulation.synthetic_drives import drive
from support.fake_driver import VERSION, FakeDriver, driving, follow
from support.tiny_served import MOUNTS, MOVING, make_log, serving

QUICK = (0.05, 0.05)
TESTS = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def _no_versions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ports are used again: what an earlier test met there does not count."""
    monkeypatch.setattr(module, "_VERSIONS", {})


def planner_of(port: int, cameras: Any = (), **options: Any) -> AlpaSimDriver:
    return AlpaSimDriver(f"127.0.0.1:{port}", cameras, **{"pauses": QUICK, **options})


def setup_of(log: DrivingLog | None = None, steps: int = 30, **options: Any) -> RolloutSetup:
    log = drive() if log is None else log
    track = next(iter(log.tracks))
    return RolloutSetup(log, track, MOTIONS["advancing-a"], steps=steps, **options)


class Noise(Mounted):
    """Other pictures at each step: as dark as the ego has come far."""

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        images = {}
        for index, name in enumerate(camera_names):
            camera = self._mounts[name].camera
            generator = np.random.default_rng(10 * state.step + index)
            pixels = generator.integers(0, 255, (camera.height, camera.width, 3))
            images[name] = (pixels * (1.0 - state.step / 60.0)).astype(np.uint8)
        return images


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


def test_the_driver_is_told_the_past_and_a_route_that_ends() -> None:
    log = drive(seconds=9.0)
    driver = FakeDriver()
    with driving(driver) as port:
        setup = setup_of(log, 20, start_timestamp_us=7_000_000)
        run_rollout(setup, planner_of(port, seed=7))
    assert driver.told[1].random_seed == 7
    motion = [one for one in driver.told if hasattr(one, "dynamic_states")]
    times = [pose.timestamp_us for one in motion for pose in one.trajectory.poses]
    assert times == list(range(5_000_000, 8_500_001, 100_000))  # 2 s before the start, then on
    assert [len(one.trajectory.poses) for one in motion] == [21, 5, 5, 5]
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


# What the driver answers


def changed(change: Callable[[Any, int], Any], **options: Any) -> tuple[FakeDriver, Any]:
    """A rollout with changed answers: the driver, and the rollout or its failure."""
    driver = FakeDriver(change=change)
    with driving(driver) as port:
        planner = planner_of(port, **options)
        (result,) = run_batch([RolloutJob(setup_of(steps=80), planner)])
    assert driver.refused == []
    assert driver.sessions == {}, "the session is not closed"
    return driver, result


def shifted(reply: Any, by_us: int, count: int | None = None) -> Any:
    """The reply at other times, and only its first poses."""
    poses = list(reply.trajectory.poses)[:count]
    for pose in poses:
        pose.timestamp_us += by_us
    return message("DriveResponse", trajectory=message("Trajectory", poses=poses))


def with_first(reply: Any, **vec: float) -> Any:
    for axis, value in vec.items():
        setattr(reply.trajectory.poses[3].pose.vec, axis, value)
    return reply


def unscaled(reply: Any) -> Any:
    reply.trajectory.poses[2].pose.quat.w += 0.5
    return reply


def in_rig_frame(reply: Any) -> Any:
    x = reply.trajectory.poses[0].pose.vec.x
    for pose in reply.trajectory.poses:
        pose.pose.vec.x -= x
    return reply


def ended(reply: Any) -> Any:
    reply.terminate_session = True
    return reply


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (lambda reply: with_first(reply, y=np.nan), r"poses\[3\].pose.vec: not finite"),
        (unscaled, r"poses\[2\].pose.quat: is not of length 1"),
        (lambda reply: shifted(reply, -4_500_000), "the trajectory ends 0.5 s before now"),
        (lambda reply: shifted(reply, 0, 1), "the trajectory has one pose"),
        (lambda reply: shifted(reply, 1 << 62), r"poses\[0\].timestamp_us: is \d+; times must"),
        (in_rig_frame, r"the trajectory begins 1\d.\d m from the ego; answer with poses in the lo"),
        (ended, r"ended the session \(terminate_session\)"),
        (lambda reply: b"\xff\xff", "answered with what is no DriveResponse"),
    ],
)
def test_faulty_plans_are_one_line_and_a_failed_row(
    change: Callable[[Any], Any], wanted: str
) -> None:
    driver, failed = changed(lambda reply, number: change(reply) if number == 3 else reply)
    assert isinstance(failed, RolloutFailure) and failed.error == "InputError"
    assert re.match(rf"127.0.0.1:\d+: drive: {wanted}", failed.reason), failed.reason
    assert "; " in failed.reason and "\n" not in failed.reason
    assert driver.calls.count("drive") == 3


def empty(reply: Any) -> Any:
    return message("DriveResponse")


def test_the_log_drives_until_the_first_plan(caplog: pytest.LogCaptureFixture) -> None:
    def slower(local_from_rig: np.ndarray, speed: float, *seen: Any) -> list[np.ndarray]:
        return follow(local_from_rig, 0.5 * speed, *seen)

    driver = FakeDriver(
        rule=slower, change=lambda reply, number: empty(reply) if number <= 4 else reply
    )
    with driving(driver) as port:
        planner = planner_of(port)
        rollout = run_rollout(setup_of(steps=40), planner)
        replayed = run_rollout(setup_of(steps=40), LogReplay())
    np.testing.assert_array_equal(rollout.ego[:21], replayed.ego[:21])
    assert replayed.ego[-1, 0] - rollout.ego[-1, 0] > 1.0
    assert planner.record_fields["log_drove_s"] == 2.0
    assert "the log drove the first 2 s" in caplog.text


def test_a_driver_that_never_plans_fails() -> None:
    driver, failed = changed(lambda reply, number: empty(reply))
    assert "drive: gave no plan within the first 4 s; see the driver's log" in failed.reason
    assert driver.calls.count("drive") == 9
    with driving(FakeDriver(change=lambda reply, number: empty(reply))) as port:
        (short,) = run_batch([RolloutJob(setup_of(steps=20), planner_of(port))])
    assert "drive: gave no plan in the whole rollout; see the driver's log" in short.reason


def test_the_last_plan_goes_on_while_there_is_none() -> None:
    _, held = changed(lambda reply, number: reply if number <= 2 else empty(reply), warm_up=0.0)
    assert "the trajectory is empty, and the plan before it has ended" in held.reason
    driver = FakeDriver(change=lambda reply, number: reply if number <= 2 else empty(reply))
    with driving(driver) as port:
        rollout = run_rollout(setup_of(steps=25), planner_of(port))
    first = rollout.predictions[1]
    for plan, step in zip(rollout.predictions[2:], rollout.plan_steps[2:], strict=True):
        world = se2.compose(rollout.ego[step, :3], plan)
        before = se2.compose(rollout.ego[5, :3], first)
        late = step - 5
        np.testing.assert_allclose(world[: 40 - late], before[late:], rtol=0, atol=1e-9)
        beyond = np.diff(world[40 - late - 1 :, :2], axis=0)  # goes on straight, as fast
        np.testing.assert_allclose(
            beyond, np.broadcast_to(before[39, :2] - before[38, :2], beyond.shape), atol=1e-9
        )


def test_plans_at_other_times_are_interpolated_and_continued() -> None:
    """Every half second up to 2 s, and none for now: a parabola, then straight on."""

    def sparse(reply: Any, number: int) -> Any:
        poses = reply.trajectory.poses
        kept = [poses[index] for index in (5, 10, 15, 20)]
        for pose in kept:
            along = (pose.timestamp_us - poses[0].timestamp_us) * 1e-6
            pose.pose.vec.x = poses[0].pose.vec.x + 10.0 * along - along**2
        return message("DriveResponse", trajectory=message("Trajectory", poses=kept))

    _, rollout = changed(sparse)
    assert isinstance(rollout, Rollout)
    t = 0.1 * np.arange(1, 21)
    last = (10.0 * 2.0 - 2.0**2) - (10.0 * 1.5 - 1.5**2)  # metres in the last half second
    beyond = 10.0 * 2.0 - 2.0**2 + last / 0.5 * t
    # Positions within 200 m have a spacing of 2^-16 m in float32; the spline's weights are below 2.
    wanted = np.concatenate([10.0 * t - t**2, beyond])
    np.testing.assert_allclose(rollout.predictions[0][:, 0], wanted, rtol=0, atol=5e-4)


REPLY = message(
    "DriveResponse",
    trajectory=message(
        "Trajectory",
        poses=[
            message("PoseAtTime", pose=pose_message(se2.to_se3([x, 0.0, 0.0])), timestamp_us=time)
            for x, time in ((0.0, 5_000_000), (4.0, 5_500_000), (8.0, 6_000_000))
        ],
    ),
).SerializeToString()


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.integers(0, len(REPLY) - 1), st.integers(0, 255)), max_size=4))
def test_damaged_answers_are_plans_or_refused(changes: list[tuple[int, int]]) -> None:
    data = bytearray(REPLY)
    for place, value in changes:
        data[place] = value
    times = 5_000_000 + 100_000 * np.arange(1, 41)
    try:
        trajectory = parse("DriveResponse", bytes(data)).trajectory
        plan = DrivenPlan.read(trajectory, 5_000_000, np.zeros(3))
    except (DecodeError, ValueError):
        assert changes
        return
    waypoints = plan.waypoints(5_000_000, np.zeros(3), times)
    assert waypoints.shape == (40, 3) and np.isfinite(waypoints).all()


@pytest.mark.parametrize(("dt", "plan_every"), [(0.05, 10), (0.2, 2)])
def test_other_steps_than_the_driver_s(dt: float, plan_every: int) -> None:
    """Plans of 0.1 s at steps of another length; 10 m/s, straight on."""
    driver = FakeDriver()
    with driving(driver) as port:
        setup = setup_of(steps=20, dt=dt, plan_every=plan_every)
        rollout = run_rollout(setup, planner_of(port))
    assert driver.refused == []
    query = [one for one in driver.told if hasattr(one, "time_query_us")]
    assert {one.time_query_us - one.time_now_us for one in query} == {round(40e6 * dt)}
    wanted = 10.0 * dt * np.arange(1, 41)
    for plan in rollout.predictions:  # to the spacing of float32 at 200 m, see above
        np.testing.assert_allclose(plan[:, 0], wanted, rtol=0, atol=1e-3)


# A driver that is not there, goes away, is slow, or is another one


@contextmanager
def process(port: int = 0) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """The fake driver in a process of its own."""
    command = [sys.executable, "-m", "support.fake_driver", str(port)]
    with subprocess.Popen(command, cwd=TESTS, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        try:
            yield child, int(child.stdout.readline())
        finally:
            child.kill()


class Killing(AlpaSimDriver):
    """Kills the driver before its third plan."""

    child: subprocess.Popen[str] | None = None
    asked = 0

    def plan(self, observation: PlannerInput) -> Plan:
        self.asked += 1
        if self.asked == 3 and self.child is not None:
            self.child.kill()
            self.child.wait()
        return super().plan(observation)


def test_a_driver_that_is_killed_costs_its_rollout_and_may_come_back() -> None:
    with process() as (child, port):
        planner = Killing(f"127.0.0.1:{port}", (), pauses=QUICK)
        planner.child = child
        failed, absent = run_batch([RolloutJob(setup_of(), planner)] * 2)
    with process(port):
        (back,) = run_batch([RolloutJob(setup_of(), planner)])
    for row, method in ((failed, "submit_egomotion_observation"), (absent, "get_version")):
        assert isinstance(row, RolloutFailure)
        assert row.reason.startswith(f"127.0.0.1:{port}: {method}: UNAVAILABLE: ")
        assert row.reason.endswith("; start the driver, or name its host and port")
    assert isinstance(back, Rollout) and back.steps_run == 30


def test_a_slow_driver_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the deadline of the call, and by the limit for a plan."""
    go_on, asked = Event(), module.DriverSession.drive

    def wait(reply: Any, number: int) -> Any:
        if number == 2:
            assert go_on.wait(60)
        return reply

    def impatient(session: module.DriverSession, now_us: int, query_us: int) -> Any:
        if now_us == 5_500_000:  # the call that is never answered, and no other
            session._client._deadline = 0.5
        return asked(session, now_us, query_us)

    driver = FakeDriver(change=wait)
    with driving(driver) as port:
        try:
            (cut,) = run_batch([RolloutJob(setup_of(plan_limit_s=1.0), planner_of(port))])
            monkeypatch.setattr(module.DriverSession, "drive", impatient)
            (late,) = run_batch([RolloutJob(setup_of(), planner_of(port))])
        finally:
            go_on.set()
    assert re.search("drive: DEADLINE_EXCEEDED: .*; give the driver more time, or", late.reason)
    assert re.search(r"gave no plan at step \d within the limit of 1 s", cut.reason)
    assert driver.sessions == {} and driver.calls.count("close_session") == 2


def test_all_results_of_a_process_are_of_one_version() -> None:
    with driving(FakeDriver()) as port:
        planner = planner_of(port)
        assert isinstance(run_batch([RolloutJob(setup_of(), planner)])[0], Rollout)
    with driving(FakeDriver(version="fake-driver-2"), port):
        (row,) = run_batch([RolloutJob(setup_of(), planner)])
    assert row.reason.endswith(
        "get_version: the driver is now fake-driver-2, git abc, API 0.54.0, it was fake-driver-1, "
        "git abc, API 0.54.0; begin again with one driver"
    )


def test_a_port_of_nobody_and_one_of_another_service() -> None:
    with driving(FakeDriver()) as port:
        pass
    with pytest.raises(InputError, match=rf"127.0.0.1:{port}: get_version: UNAVAILABLE: .*; start"):
        run_rollout(setup_of(), planner_of(port))
    with (
        serving() as renderer,
        pytest.raises(InputError, match=r"get_version: UNIMPLEMENTED: .*; name the port"),
    ):
        run_rollout(setup_of(), planner_of(renderer.port))


def test_cameras_that_the_driver_refuses_or_the_log_lacks() -> None:
    driver = FakeDriver(["front"])
    with driving(driver) as port:
        for cameras, wanted in (
            (["front", "bent"], "submit_image_observation: UNKNOWN: Camera bent not in desired"),
            (["bent"], r"start_session: UNKNOWN: Requested cameras \['front'\] are missing"),
            (["rear"], r"planner alpasim:.*: camera rear: is needed and not there"),
        ):  # fmt: skip
            with pytest.raises(InputError, match=wanted):
                run_rollout(setup_of(), planner_of(port, cameras), Noise(MOUNTS))
        assert driver.sessions == {}
        named = planner_of(port, {"front": "bent"})  # by the driver's name
        run_rollout(setup_of(), named, Noise(MOUNTS))
    spec = next(one for one in reversed(driver.told) if hasattr(one, "rollout_spec")).rollout_spec
    camera = spec.vehicle.available_cameras[0]
    assert (camera.logical_id, camera.intrinsics.resolution_w) == ("front", 40)
    assert camera.intrinsics.opencv_pinhole_param.radial_coeffs[0] == -0.2


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
    assert planner_source_files(planner.name) == ()


def test_nuplan_s_cameras_are_rendered_for_a_driver_that_wants_them() -> None:
    planner = make_planner("alpasim:host:1/CAM_F0=nuplan_f0")
    mounts = MOUNTS | virtual_mounts(planner, MOUNTS)
    assert camera_choice(planner, mounts) == {"CAM_F0": "nuplan_f0"}
    assert not mounts["nuplan_f0"].camera.is_rectified


@pytest.mark.parametrize("words", ["", "host", ":1", "host:x", "host:0", "host:70000", "host:1²"])
def test_words_without_host_and_port(words: str) -> None:
    with pytest.raises(InputError, match="names no host and port; give alpasim:HOST:PORT"):
        driver_planner(words)


@pytest.mark.parametrize("words", ["h:1/,", "h:1/a,a", "h:1/a=", "h:1/=b"])
def test_words_with_faulty_cameras(words: str) -> None:
    with pytest.raises(InputError, match=r"is empty or there twice; give names with commas"):
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
print(child == 0, probe_path(planner)[-1].tobytes().hex(), flush=True)
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
