from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.geometry import se2
from recast.planning import ReferenceRoute
from recast.simulation import MOTIONS, ScriptMotion, StartSituation
from support.synthetic_drives import drive

STEPS, DT = 160, 0.1
EGO_LENGTH, EGO_S = 5.176, 20.0
SIZE = np.array([4.2, 1.8, 1.5])

FROM_ROUTE = sorted(set(MOTIONS) - {"log-replay-a", "idm-a", "idm-b"})
"""Scenarios that need no log."""
scenarios = st.sampled_from(FROM_ROUTE)
speeds = st.floats(0.0, 15.0)
curvatures = st.floats(-0.01, 0.01)


def situation(
    speed: float, curvature: float = 0.0, neighbour: float | None = None, **pose: object
) -> StartSituation:
    log = drive(speed=15.0, seconds=30.0, curvature=curvature, **pose)
    route = ReferenceRoute.from_trajectory(log.world_from_rig)
    return StartSituation(route, EGO_S, speed, EGO_LENGTH, SIZE, neighbour)


def script(motion: ScriptMotion, start: StartSituation) -> tuple[np.ndarray, ...]:
    states = motion.script(start, STEPS, DT)
    assert states.shape == (STEPS + 1, 4)
    return (states, *start.route.project(states[:, :2]))


def gap(start: StartSituation, s: float) -> float:
    """Bumper to bumper on a straight road, for an actor whose box is parallel to the route."""
    return s - start.ego_s - (EGO_LENGTH + SIZE[0]) / 2


@settings(max_examples=40, deadline=None)
@given(name=scenarios, speed=speeds, curvature=curvatures)
def test_states_are_continuous_and_speeds_not_negative(
    name: str, speed: float, curvature: float
) -> None:
    states, _, _ = script(MOTIONS[name], situation(speed, curvature))
    assert states[:, 3].min() >= 0.0
    moved = np.linalg.norm(np.diff(states[:, :2], axis=0), axis=1) / DT
    # A lane beside a bend is longer or shorter than the route by lateral times curvature.
    np.testing.assert_allclose(moved, states[:-1, 3], atol=0.3 + 0.05 * states[0, 3])
    assert np.abs(np.diff(moved)).max() < 0.5  # no jump in speed
    assert np.abs(se2.wrap_angle(np.diff(states[:, 2]))).max() < 0.25
    assert np.abs(states[:, 2]).max() <= np.pi


@settings(max_examples=40, deadline=None)
@given(name=scenarios, speed=speeds)
def test_forward_motion_points_along_the_heading(name: str, speed: float) -> None:
    states, _, _ = script(MOTIONS[name], situation(speed))
    moved = np.diff(states[:, :2], axis=0)
    along = np.sum(
        moved * np.stack([np.cos(states[:-1, 2]), np.sin(states[:-1, 2])], axis=1), axis=1
    )
    assert along.min() > -1e-9


@pytest.mark.parametrize(("speed", "reference"), [(2.0, 4.0), (8.0, 8.0), (20.0, 12.0)])
@pytest.mark.parametrize(
    ("name", "expected_gap", "start_share", "end_share"),
    [("cut-in-a", 6.0, 0.8, 0.5), ("cut-in-b", 12.0, 0.7, 0.35)],
)
def test_cut_in(
    name: str,
    expected_gap: float,
    start_share: float,
    end_share: float,
    speed: float,
    reference: float,
) -> None:
    start = situation(speed)
    states, s, lateral = script(MOTIONS[name], start)
    assert gap(start, s[0]) == pytest.approx(expected_gap, abs=1e-6)
    assert states[0, 3] == pytest.approx(start_share * reference)
    assert states[-1, 3] == pytest.approx(end_share * reference, rel=0.05)
    assert lateral[0] == pytest.approx(3.5)
    assert np.all(np.diff(lateral) <= 1e-9)
    np.testing.assert_allclose(lateral[45:], 0.0, atol=1e-6)
    np.testing.assert_allclose(states[45:, 2], 0.0, atol=1e-6)
    assert states[:, 2].min() < -0.1  # it turned its nose towards the lane


def test_cut_in_timing() -> None:
    start = situation(8.0)
    _, _, a = script(MOTIONS["cut-in-a"], start)
    _, _, b = script(MOTIONS["cut-in-b"], start)
    for lateral, first, last in ((a, 5, 30), (b, 10, 40)):
        assert lateral[first] == pytest.approx(3.5, abs=1e-6)
        assert lateral[first + 2] < 3.5 - 1e-4
        assert lateral[last - 2] > 1e-4
        assert lateral[last] == pytest.approx(0.0, abs=1e-6)
        assert lateral[(first + last) // 2] == pytest.approx(1.75, abs=0.15)


def test_cut_in_comes_from_the_neighbouring_lane() -> None:
    start = situation(8.0, neighbour=-3.2)
    states, _, lateral = script(MOTIONS["cut-in-a"], start)
    assert lateral[0] == pytest.approx(-3.2)
    assert states[:, 2].max() > 0.1


@pytest.mark.parametrize(("speed", "reference"), [(2.0, 4.0), (8.0, 8.0), (20.0, 12.0)])
@pytest.mark.parametrize(
    ("name", "expected_gap", "in_lane", "brakes"),
    [("cut-in-stop-a", 10.0, 30, 35), ("cut-in-stop-b", 16.0, 40, 50)],
)
def test_cut_in_and_stop(
    name: str, expected_gap: float, in_lane: int, brakes: int, speed: float, reference: float
) -> None:
    start = situation(speed)
    states, s, lateral = script(MOTIONS[name], start)
    assert gap(start, s[0]) == pytest.approx(expected_gap, abs=1e-6)
    np.testing.assert_allclose(lateral[in_lane:], 0.0, atol=1e-6)
    assert lateral[in_lane - 2] > 1e-4
    np.testing.assert_allclose(np.diff(s[: brakes + 1]), 0.09 * reference, atol=1e-9)
    stopped = brakes + int(np.ceil(0.9 * reference / 0.25 - 1e-9))
    np.testing.assert_allclose(np.diff(states[brakes : stopped - 1, 3]), -0.25, atol=1e-9)
    assert states[stopped - 1, 3] > 0.0
    np.testing.assert_array_equal(states[stopped:, 3], 0.0)
    np.testing.assert_array_equal(np.diff(s[stopped:]), 0.0)


@pytest.mark.parametrize(("name", "needed"), [("cut-in-stop-a", 3.95), ("cut-in-stop-b", 3.25)])
def test_cut_in_and_stop_leaves_room_to_stop(name: str, needed: float) -> None:
    """The reason that its file gives for its numbers: who brakes 0.9 s later stops behind it."""
    start = situation(12.0)
    states, s, _ = script(MOTIONS[name], start)
    before = int(np.argmax(np.diff(states[:, 3]) < -0.2))  # it brakes in the next step
    room = gap(start, s[-1]) - 12.0 * (before * DT + 0.9)
    assert 12.0**2 / (2 * room) <= needed


@pytest.mark.parametrize(
    ("name", "expected_gap", "speed", "distance", "offset"),
    [("oncoming-a", 35.0, 3.0, 15.0, 0.0), ("oncoming-b", 55.0, 6.0, 25.0, 0.3)],
)
def test_oncoming_stops_after_its_distance(
    name: str, expected_gap: float, speed: float, distance: float, offset: float
) -> None:
    start = situation(9.0)
    states, s, lateral = script(MOTIONS[name], start)
    assert gap(start, s[0]) == pytest.approx(expected_gap, abs=1e-6)
    assert states[0, 3] == pytest.approx(speed)
    np.testing.assert_allclose(np.abs(states[:, 2]), np.pi, atol=1e-9)
    np.testing.assert_allclose(lateral, offset, atol=1e-9)
    assert s[0] - s[-1] == pytest.approx(distance, abs=0.1)
    assert states[-1, 3] == 0.0
    np.testing.assert_array_equal(states[-20:, :3], np.repeat(states[-1:, :3], 20, axis=0))


def test_oncoming_through_drives_on_and_says_so() -> None:
    motion = MOTIONS["oncoming-through-a"]
    assert motion.name == "oncoming-through"
    _, s, _ = script(motion, situation(9.0))
    np.testing.assert_allclose(np.diff(s), -0.3, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "speed", "expected_gap", "yaw", "offset"),
    [
        ("stationary-a", 3.0, 20.0, 0.0, 0.0),
        ("stationary-a", 12.0, 144 / 3.6 + 4, 0.0, 0.0),
        ("stationary-b", 3.0, 35.0, 0.17, 0.3),
        ("stationary-b", 12.0, 144 / 2.4 + 6, 0.17, 0.3),
    ],
)
def test_stationary_never_moves(
    name: str, speed: float, expected_gap: float, yaw: float, offset: float
) -> None:
    start = situation(speed)
    states, s, lateral = script(MOTIONS[name], start)
    np.testing.assert_array_equal(states, np.repeat(states[:1], STEPS + 1, axis=0))
    assert states[0, 3] == 0.0
    assert gap(start, s[0]) == pytest.approx(expected_gap, abs=1e-6)
    assert lateral[0] == pytest.approx(offset)
    assert se2.wrap_angle(states[0, 2] - np.pi) == pytest.approx(yaw)


@pytest.mark.parametrize(
    ("name", "expected_gap", "share"), [("advancing-a", 5.0, 0.5), ("advancing-b", 12.0, 0.65)]
)
def test_advancing_stays_in_the_next_lane(name: str, expected_gap: float, share: float) -> None:
    start = situation(10.0)
    states, s, lateral = script(MOTIONS[name], start)
    assert gap(start, s[0]) == pytest.approx(expected_gap, abs=1e-6)
    np.testing.assert_allclose(lateral, 3.5, atol=1e-9)
    np.testing.assert_allclose(states[:, 3], 10 * share, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(name=scenarios, speed=speeds, x=st.floats(-500, 500), turn=st.floats(-3.0, 3.0))
def test_motions_move_with_the_world(name: str, speed: float, x: float, turn: float) -> None:
    moved = (x, -0.5 * x, turn)
    here = MOTIONS[name].script(situation(speed, 0.005), 40, DT)
    there = MOTIONS[name].script(situation(speed, 0.005, world_from_start=moved), 40, DT)
    expected = se2.compose(moved, here[:, :3])
    np.testing.assert_allclose(there[:, :2], expected[:, :2], atol=1e-6)
    np.testing.assert_allclose(se2.wrap_angle(there[:, 2] - expected[:, 2]), 0, atol=1e-6)
    np.testing.assert_allclose(there[:, 3], here[:, 3], atol=1e-9)


def test_a_longer_script_begins_like_a_shorter_one() -> None:
    for motion in (MOTIONS[name] for name in FROM_ROUTE):
        start = situation(9.0)
        np.testing.assert_array_equal(
            motion.script(start, 30, DT), motion.script(start, 90, DT)[:31]
        )
