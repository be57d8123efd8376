from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.geometry import se2
from recast.planning import ReferenceRoute
from recast.simulation import MOTIONS, Along, RouteCrossing, ScriptMotion, StartSituation
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


def crossing(**numbers: float) -> RouteCrossing:
    return RouteCrossing("t", **{"gap": 20.0, "speed": 1.4, "begin": -5.0, **numbers})


@settings(max_examples=40, deadline=None)
@given(
    speed=st.floats(0.5, 8.0),
    begin=st.floats(2.0, 20.0),
    right=st.booleans(),
    delay=st.floats(0.0, 4.0),
)
def test_a_crossing_is_straight_across_at_its_speed(
    speed: float, begin: float, right: bool, delay: float
) -> None:
    side = -1.0 if right else 1.0
    start = situation(8.0)
    states, s, lateral = script(crossing(speed=speed, begin=side * begin, delay=delay), start)
    np.testing.assert_allclose(s, EGO_S + EGO_LENGTH / 2 + 20.0 + SIZE[1] / 2, atol=1e-6)
    walked = begin - side * lateral
    assert walked[0] == pytest.approx(0.0, abs=1e-9) and np.all(np.diff(walked) >= -1e-9)
    standing = int(delay / DT)
    assert np.all(walked[: standing + 1] < 1e-9)
    ramp = 0.0 if delay == 0.0 else speed / 3.0
    late = DT * np.arange(STEPS + 1) > delay + ramp + 2 * DT
    assert np.allclose(states[late, 3], speed)
    # Half of the ramp is lost, but for the substep in which it begins.
    expected = speed * (DT * np.arange(STEPS + 1)[late] - delay - ramp / 2)
    np.testing.assert_allclose(walked[late], expected, atol=0.02 * speed)
    np.testing.assert_allclose(states[:, 2], -side * np.pi / 2, atol=1e-6)


def test_a_crossing_stops_in_the_middle_for_a_while_or_for_good() -> None:
    for_good, _, lateral = script(crossing(pause_at=0.5), situation(8.0))
    assert lateral[-1] == pytest.approx(0.5, abs=1e-6) and for_good[-1, 3] == 0.0
    _, _, lateral = script(crossing(pause_at=0.5, pause=3.0), situation(8.0))
    there = np.flatnonzero(np.abs(lateral - 0.5) < 1e-6)
    assert (there[-1] - there[0]) * DT == pytest.approx(3.0, abs=0.15)
    assert lateral[-1] > 5.0


def test_a_crossing_that_turns_round_comes_back_to_its_kerb() -> None:
    states, _, lateral = script(crossing(turn_at=-0.5, pause_at=-2.0, pause=1.0), situation(8.0))
    assert lateral.max() == pytest.approx(-0.5, abs=1e-6)
    assert lateral[-1] == pytest.approx(-5.0, abs=1e-6) and states[-1, 3] == 0.0
    assert states[0, 2] == pytest.approx(np.pi / 2)
    assert states[-1, 2] == pytest.approx(-np.pi / 2)
    # It stands, then turns round, where both are at one place.
    states, _, lateral = script(crossing(turn_at=-0.5, pause_at=-0.5, pause=2.0), situation(8.0))
    there = np.flatnonzero(np.abs(lateral + 0.5) < 1e-6) * DT
    assert there[-1] - there[0] == pytest.approx(2.0 + 1.3, abs=0.15)
    assert np.allclose(states[: round((there[0] + 1.9) / DT), 2], np.pi / 2)


@pytest.mark.parametrize(
    "numbers", [{"speed": 8.0, "begin": -4.0, "pause_at": -3.0}, {"pause_at": -5.0}]
)
def test_a_crossing_brakes_with_3_m_s2_from_its_first_state_on(numbers: dict[str, float]) -> None:
    states, _, lateral = script(crossing(**numbers), situation(8.0))
    assert np.abs(np.diff(states[:, 3])).max() <= 3.0 * DT * 1.2
    assert lateral[-1] == pytest.approx(numbers["pause_at"], abs=1e-6)


@pytest.mark.parametrize(
    ("numbers", "what"),
    [
        ({"begin": 0.0}, "begin: is 0, on the route"),
        ({"pause_at": -6.0}, "pause_at: is -6, behind"),
        ({"turn_at": -5.5}, "turn_at: is -5.5, behind"),
        ({"pause": 2.0}, "pause: is the time at pause_at"),
        ({"pause_at": 1.0, "turn_at": 0.5}, "pause_at: lies beyond turn_at"),
    ],
)
def test_a_crossing_that_cannot_be_is_refused(numbers: dict[str, float], what: str) -> None:
    with pytest.raises(ValueError, match=what):
        crossing(**numbers)


def test_who_goes_along_may_move_over() -> None:
    ride = Along("t", gap=10.0, speed=4.0, lateral=-2.5, to=-0.5, delay=1.0, duration=2.0)
    _, s, lateral = script(ride, situation(8.0))
    assert gap(situation(8.0), s[0]) == pytest.approx(10.0)
    np.testing.assert_allclose(s - s[0], 4.0 * DT * np.arange(STEPS + 1), atol=1e-6)
    assert np.allclose(lateral[:11], -2.5) and np.allclose(lateral[31:], -0.5)
    assert lateral[20] == pytest.approx(-1.5)
    _, _, beside = script(Along("t", gap=10.0, speed=4.0, lateral=-2.5), situation(8.0))
    assert np.allclose(beside, -2.5)
