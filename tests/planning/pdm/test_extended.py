"""NAVSIM v2's sub-metrics on trajectories made by hand; docs/metrics.md has the same numbers."""

import numpy as np
import pytest
import shapely

from recast.dynamics import PACIFICA
from recast.dynamics import state as ego
from recast.planning.pdm import AgentKind, extended_comfort, observed, score_extended
from recast.planning.pdm.scorer import ExtendedScores
from support.straight_road import (
    CENTRELINE,
    CROSSING,
    ROUTE_LANES,
    STATES,
    road,
    seen,
    straight,
    user,
)

FRONT = PACIFICA.front_length


def scores(*states, forecast=None, history=None):
    return score_extended(
        np.stack(states), forecast or seen(), CENTRELINE, road(), ROUTE_LANES, history=history
    )


@pytest.mark.parametrize(
    ("who", "value"),
    [
        (user(20.0), 0.0),  # a standing car, met by the front bumper after 1.4 s
        (user(20.0, kind=AgentKind.PEDESTRIAN, size=(0.6, 0.6)), 0.0),
        (user(20.0, kind=AgentKind.STATIC, size=(1.0, 1.0)), 0.5),
        (user(-10.0, speed=14.0), 1.0),  # hits the ego from behind
        (user(20.0, y=6.0), 1.0),
    ],
)
def test_no_collision(who, value):
    assert scores(straight(10.0), forecast=seen(who)).no_collision[0] == value


def test_an_obstacle_is_met_only_while_it_is_there():
    car = user(20.0)
    poses = np.tile(car.pose, (1, STATES, 1))
    poses[0, 10:] = np.nan  # the ego reaches it after 1.4 s
    assert scores(straight(10.0), forecast=observed([car], poses)).no_collision[0] == 1.0
    poses[0, 20:] = car.pose
    assert scores(straight(10.0), forecast=observed([car], poses)).no_collision[0] == 0.0


def test_being_hit_from_the_side_is_at_fault_across_lanes_only():
    def sideways(y):
        # alongside, and as fast: touches the left side, not the front bumper
        return scores(
            straight(10.0, y=y), forecast=seen(user(1.0, y=y + 2.1, speed=10.0))
        ).no_collision[0]

    assert sideways(0.0) == 1.0
    assert sideways(1.2) == 0.0


@pytest.mark.parametrize(("y", "value"), [(-0.6, 1.0), (-0.61, 0.0)])
def test_drivable_area(y, value):
    # 1.75 m to the edge, and half of 2.297 m: 0.6015 m of room
    assert scores(straight(10.0, y=y)).drivable[0] == value


@pytest.mark.parametrize(
    ("speed", "value"),
    [(1.8, 1.0), (1.9, 0.5), (5.4, 0.5), (5.5, 0.0)],  # 11 steps: 1.98, 2.09, 5.94, 6.05 m
)
def test_driving_direction(speed, value):
    assert scores(straight(speed, y=3.5)).direction[0] == value


def test_driving_direction_does_not_count_in_a_crossing():
    assert scores(straight(5.5, x=CROSSING[0] + 2.0, y=3.5)).direction[0] == 1.0


def test_only_one_second_counts_for_the_driving_direction():
    # Two visits to the oncoming lane, 2.2 s apart: each the jump aside, 3.51 m, and six steps of
    # 0.25 m. Both together are 10.0 m, which would be 0.
    states = straight(2.5)
    states[5:12, ego.Y] = states[27:34, ego.Y] = 3.5
    assert scores(states).direction[0] == 0.5


@pytest.mark.parametrize(("red_until", "value"), [(STATES, 0.0), (26, 0.0), (25, 1.0)])
def test_traffic_light(red_until, value):
    # The front bumper is at 4.05 + 10 t and the connector at 30 m: reached at step 26.
    light = shapely.box(30.0, -1.75, 50.0, 1.75)
    red = np.arange(STATES) <= red_until
    found = scores(straight(10.0), forecast=seen(red=[("across", light, red)]))
    assert found.traffic_light[0] == value
    assert found.no_collision[0] == 1.0


def test_progress():
    assert scores(straight(10.0), straight(8.0)).progress.tolist() == [1.0, 0.8]
    assert scores(straight(8.0), straight(10.0)).progress.tolist() == [0.8, 1.0]
    assert scores(straight(1.25), straight(0.0)).progress.tolist() == [1.0, 1.0]  # 5 m
    # The second one touches a cone: its 40 m count half, so that 32 m are the best, not 20.
    cone = user(40.0, kind=AgentKind.STATIC, size=(0.5, 0.5))
    found = scores(straight(8.0), straight(10.0), forecast=seen(cone))
    assert found.no_collision.tolist() == [1.0, 0.5]
    assert found.progress.tolist() == [1.0, 1.0]


@pytest.mark.parametrize(("first_hit", "value"), [(31, 0.0), (32, 1.0)])
def test_time_to_collision(first_hit, value):
    # At 10 m/s, 0.9 s reach 9 m beyond the bumper: step i meets what stands at 13.05 + i metres.
    rear = FRONT + 9.0 + first_hit - 0.5
    found = scores(straight(10.0), forecast=seen(user(rear + 2.0)))
    assert found.ttc[0] == value


@pytest.mark.parametrize(("samples", "value"), [(19, 1.0), (20, 0.0)])
def test_lane_keeping(samples, value):
    states = straight(10.0)
    states[5 : 5 + samples, ego.Y] = 0.55
    assert scores(states).lane_keeping[0] == value


@pytest.mark.parametrize(("before", "value"), [(10, 0.0), (9, 1.0)])
def test_lane_keeping_is_paused_in_a_crossing(before, value):
    """Samples beside the centreline before and after it count as one row, those in it do not."""
    start, end = CROSSING
    # Centre at x + 1.461; the crossing is passed in one step.
    states = straight(10.0, y=0.55)
    x = states[:, ego.X]
    x[:before] = start - 5.0 - np.arange(before)[::-1]
    x[before : before + 3] = start + 10.0  # inside, for three samples
    x[before + 3 : before + 13] = end + 5.0 + np.arange(10)
    states[before : before + 3, ego.Y] = 0.0
    states[before + 13 :, ego.Y] = 0.0
    x[before + 13 :] = end + 16.0
    assert scores(states).lane_keeping[0] == value


def test_history_comfort():
    calm = straight(10.0)
    history = np.repeat(calm[:1], 14, axis=0)
    assert scores(calm, history=history).history_comfort[0] == 1.0
    history[:, ego.AX] = 3.0  # more than 2.40 m/s^2
    assert scores(calm, history=history).history_comfort[0] == 0.0
    assert scores(calm, history=history[:0]).history_comfort[0] == 1.0
    assert scores(calm, history=None).history_comfort[0] == 1.0


def test_history_comfort_is_that_of_the_box_centre():
    # 0.9 rad/s is within 0.95; 1.461 m * 0.81 / s^2 = 1.18 m/s^2 are added at the centre.
    for acceleration, value in ((1.2, 1.0), (1.3, 0.0)):
        states = straight(5.0, acceleration=acceleration, yaw_rate=0.9)
        found = scores(states, history=states[:0])
        assert found.history_comfort[0] == value


@pytest.mark.parametrize(("twist", "value"), [(0.27, 1.0), (0.28, 0.0)])
def test_history_comfort_counts_the_angular_acceleration(twist, value):
    states = straight(5.0, acceleration=2.0)
    states[:, ego.ANGULAR_ACCELERATION] = twist  # 1.461 m of it: 0.394 or 0.409 m/s^2
    assert scores(states, history=states[:0]).history_comfort[0] == value


@pytest.mark.parametrize(
    ("change", "value"),
    [
        ({"acceleration": 0.69}, 1.0),
        ({"acceleration": 0.71}, 0.0),
        ({"acceleration": -0.71}, 0.0),
        ({"yaw_rate": 0.099}, 1.0),
        ({"yaw_rate": 0.101}, 0.0),
    ],
)
def test_extended_comfort(change, value):
    assert extended_comfort(straight(8.0, **change), straight(8.0), 0.5) == value


def test_extended_comfort_smooths_the_yaw_acceleration_by_parabolas():
    """Of c t^3 they give the second derivative, 6 c t, but at the ends that of the third sample."""
    times = 0.1 * np.arange(36) - 1.75
    ends = times.copy()
    ends[:2], ends[-2:] = times[2], times[-3]
    cubic, parabolas = (6.0 * np.sqrt(np.mean(part**2)) for part in (times, ends))
    assert parabolas < 0.99 * cubic
    between = 0.1 / ((cubic + parabolas) / 2)
    turned = straight(8.0)
    turned[:36, ego.HEADING] = between * times**3
    assert extended_comfort(turned, straight(8.0), 0.5) == 1.0
    turned[:36, ego.HEADING] *= cubic / parabolas
    assert extended_comfort(turned, straight(8.0), 0.5) == 0.0


def test_extended_comfort_compares_the_same_times():
    """Braking that begins 2 s after the first plan begins 1.5 s after the second."""
    first, second = straight(8.0), straight(8.0)
    first[20:, ego.AX] = second[15:, ego.AX] = -2.0
    assert extended_comfort(second, first, 0.5) == 1.0
    assert extended_comfort(second, first, 0.1) == 0.0
    with pytest.raises(ValueError, match=r"interval 0\.6 s"):
        extended_comfort(second, first, 0.6)


def test_total():
    values = dict.fromkeys(
        ["no_collision", "drivable", "direction", "traffic_light", "ttc", "lane_keeping"], 1.0
    )
    one = ExtendedScores(
        **{key: np.ones(1) for key in values}, progress=np.array([0.8]), history_comfort=np.ones(1)
    )
    assert one.total()[0] == pytest.approx(13 / 14)
    assert one.total([1.0])[0] == pytest.approx(15 / 16)
    assert one.total([0.0])[0] == pytest.approx(13 / 16)
    halved = ExtendedScores(**{**vars(one), "direction": np.array([0.5])})
    assert halved.total([1.0])[0] == pytest.approx(15 / 32)


def test_the_proposals_must_be_whole():
    with pytest.raises(ValueError, match=r"expected \(P, 41, 11\), got \(1, 40, 11\)"):
        scores(straight(10.0)[:40])
