"""Drivers that are not there, go away, are slow or other ones; and what a strict one refuses."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.planning import (
    Plan,
    PlannerInput,
)
from recast.simulation import (
    run_rollout,
)
from recast_bridges.alpasim import driver_session as module
from recast_bridges.alpasim.client import ServiceClient
from recast_bridges.alpasim.driver import AlpaSimDriver
from recast_bridges.alpasim.messages import pose_message, read_pose
from support.driven import QUICK, Noise, failure_of, planner_of, setup_of
from support.fake_driver import FakeDriver, driving
from support.tiny_served import MOUNTS, serving

TESTS = Path(__file__).parents[2]


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
        killed, absent = (failure_of(setup_of(), planner) for _ in range(2))
    with process(port):
        back = run_rollout(setup_of(), planner)
    for row, method in ((killed, "submit_egomotion_observation"), (absent, "get_version")):
        assert row.reason.startswith(f"127.0.0.1:{port}: {method}: UNAVAILABLE: ")
        assert row.reason.endswith("; start the driver, or name its host and port")
    assert back.steps_run == 30


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
            cut = failure_of(setup_of(plan_limit_s=1.0), planner_of(port))
            monkeypatch.setattr(module.DriverSession, "drive", impatient)
            late = failure_of(setup_of(), planner_of(port))
        finally:
            go_on.set()
    assert re.search("drive: DEADLINE_EXCEEDED: .*; give the driver more time, or", late.reason)
    assert re.search(r"gave no plan at step \d within the limit of 1 s", cut.reason)
    assert driver.sessions == {} and driver.calls.count("close_session") == 2


def test_all_results_of_a_process_are_of_one_version() -> None:
    with driving(FakeDriver()) as port:
        planner = planner_of(port)
        run_rollout(setup_of(), planner)
    with driving(FakeDriver(version="fake-driver-2"), port):
        row = failure_of(setup_of(), planner)
    assert row.reason.endswith(
        "get_version: the driver is now fake-driver-2, git abc, API 0.54.0, but was fake-driver-1, "
        "git abc, API 0.54.0 before; run again with the same driver throughout"
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


def test_without_the_extra_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "grpc", None)
    monkeypatch.delitem(sys.modules, "recast_bridges.alpasim.client")
    with pytest.raises(InputError, match=r"is not installed; pip install 'recast-sim\[alpasim\]'"):
        run_rollout(setup_of(), planner_of(1))


def test_cameras_that_the_driver_refuses_or_the_log_lacks() -> None:
    driver = FakeDriver(["front"])
    with driving(driver) as port:
        for cameras, wanted in (
            (["front", "bent"], "submit_image_observation: UNKNOWN: Camera bent not in desired"),
            (["bent"], r"start_session: UNKNOWN: Requested cameras \['front'\] are missing"),
            (["rear"], r"planner alpasim:.*: camera rear: is needed but missing"),
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


def twice(request: Any) -> list[Any]:
    return [request, request]


def never(request: Any) -> list[Any]:
    return []


def of_nobody(request: Any) -> list[Any]:
    request.session_uuid = "nobody"
    return [request]


def a_second_ago(request: Any) -> list[Any]:
    for pose in request.trajectory.poses:
        pose.timestamp_us -= 1_000_000
    return [request]


def stateless(request: Any) -> list[Any]:
    del request.dynamic_states[-1]
    return [request]


def backwards(request: Any) -> list[Any]:
    for state in request.dynamic_states:
        state.linear_velocity.x *= -1.0
    return [request]


def relative_to_the_last(request: Any) -> list[Any]:
    last = read_pose(request.trajectory.poses[-1].pose, "last")
    for pose in request.trajectory.poses:
        moved = np.linalg.inv(last) @ read_pose(pose.pose, "pose")
        pose.pose.CopyFrom(pose_message(moved))
    return [request]


def in_the_world(request: Any) -> list[Any]:
    for point in request.route.waypoints:
        point.x += 40.0
    return [request]


def with_a_gap(request: Any) -> list[Any]:
    request.route.waypoints[2].x = np.nan
    return [request]


def cut_short(request: Any) -> list[Any]:
    request.camera_image.image_bytes = request.camera_image.image_bytes[:20]
    return [request]


def late(request: Any) -> list[Any]:
    request.camera_image.frame_start_us -= 1_000_000
    request.camera_image.frame_end_us -= 1_000_000
    return [request]


@pytest.mark.parametrize(
    ("method", "change", "wanted"),
    [
        ("start_session", twice, "start_session: ALREADY_EXISTS: Session"),
        ("start_session", never, "submit_image_observation: UNKNOWN: Session .* does not exist"),
        ("drive", of_nobody, "drive: UNKNOWN: Session nobody does not exist"),
        ("drive", twice, "drive: FAILED_PRECONDITION: drives are not in time order"),
        ("submit_image_observation", twice, "Frame 5000000 is not in time order"),
        ("submit_image_observation", never, "drive: .*: no image of front for now"),
        ("submit_image_observation", late, "drive: .*: no image of front for now"),
        ("submit_image_observation", cut_short, "a damaged image"),
        ("submit_egomotion_observation", never, "drive: .*: no egomotion for now"),
        ("submit_egomotion_observation", twice, "egomotion is not in time order"),
        ("submit_egomotion_observation", a_second_ago, "drive: .*: no egomotion for now"),
        ("submit_egomotion_observation", stateless, "states are not 1:1 with poses"),
        ("submit_egomotion_observation", backwards, "wrong frame"),
        ("submit_egomotion_observation", relative_to_the_last, "wrong frame"),
        ("submit_route", never, "drive: .*: no route for now"),
        ("submit_route", in_the_world, "the route is of another frame"),
        ("submit_route", with_a_gap, "NaN before a point"),
    ],
)
def test_the_fake_driver_is_strict(
    method: str, change: Callable[[Any], list[Any]], wanted: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the client must not do, done between it and the channel."""
    call = ServiceClient.call

    def changed(client: ServiceClient, name: str, request: Any, *more: Any) -> Any:
        replies = [
            call(client, name, one, *more)
            for one in (change(request) if name == method else [request])
        ]
        return replies[-1] if replies else None

    monkeypatch.setattr(ServiceClient, "call", changed)
    with driving(FakeDriver()) as port, pytest.raises(InputError, match=wanted) as refused:
        run_rollout(setup_of(), planner_of(port, ["front"]), Noise(MOUNTS))
    assert "\n" not in str(refused.value)
