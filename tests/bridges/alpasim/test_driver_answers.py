"""What a driver answers: plans of every kind, none, and faulty ones."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from google.protobuf.message import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.geometry import se2
from recast.planning import (
    LogReplay,
)
from recast.simulation import (
    Rollout,
    RolloutFailure,
    run_rollout,
)
from recast_bridges.alpasim.driver import DrivenPlan
from recast_bridges.alpasim.messages import message, parse, pose_message
from support.driven import attempt, failure_of, planner_of, setup_of
from support.fake_driver import FakeDriver, driving, follow


def changed(change: Callable[[Any, int], Any], **options: Any) -> tuple[FakeDriver, Any]:
    """A rollout with changed answers: the driver, and the rollout or its failure."""
    driver = FakeDriver(change=change)
    with driving(driver) as port:
        planner = planner_of(port, **options)
        result = attempt(setup_of(steps=80), planner)
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
        (lambda reply: with_first(reply, y=np.nan), r"poses\[3\].pose.vec: is not finite"),
        (unscaled, r"poses\[2\].pose.quat: does not have length 1"),
        (lambda reply: shifted(reply, -4_500_000), "the trajectory ends 0.5 s before now"),
        (lambda reply: shifted(reply, 0, 1), "the trajectory has one pose"),
        (
            lambda reply: shifted(reply, 1 << 62),
            r"poses\[0\].timestamp_us: is \d+, not a valid later",
        ),
        (in_rig_frame, r"the trajectory begins 1\d.\d m from the ego; answer with poses in the lo"),
        (ended, r"ended the session \(terminate_session\)"),
        (lambda reply: b"\xff\xff", "answered with data that is not a DriveResponse"),
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
        tracked = LogReplay()
        tracked.replays_log = False  # the driver's first plans are executed as any others
        replayed = run_rollout(setup_of(steps=40), tracked)
    np.testing.assert_array_equal(rollout.ego[:21], replayed.ego[:21])
    assert replayed.ego[-1, 0] - rollout.ego[-1, 0] > 1.0
    assert planner.record_fields["log_drove_s"] == 2.0
    assert "gave no plan in the first 2 s, so the ego followed the log" in caplog.text


def test_a_driver_that_never_plans_fails() -> None:
    driver, failed = changed(lambda reply, number: empty(reply))
    assert "drive: gave no plan within the first 4 s; see the driver's log" in failed.reason
    assert driver.calls.count("drive") == 9
    with driving(FakeDriver(change=lambda reply, number: empty(reply))) as port:
        short = failure_of(setup_of(steps=20), planner_of(port))
    assert "drive: gave no plan in the whole rollout; see the driver's log" in short.reason


def test_the_last_plan_goes_on_while_there_is_none() -> None:
    _, held = changed(lambda reply, number: reply if number <= 2 else empty(reply), warm_up=0.0)
    assert "the trajectory is empty, and the previous plan has ended" in held.reason
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
