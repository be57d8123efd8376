"""Vehicles on a straight road that follow their lanes and react to the ego."""

from __future__ import annotations

import numpy as np
import pytest

from recast.geometry import boxes
from recast.planning.pdm import AgentKind, Obstacle
from recast_bridges.scores.idm_traffic import IdmTraffic
from recast_bridges.scores.two_stage import PlanSituation, score_plan
from support.straight_road import CROSSING, STATES, road, straight, user

FAR = straight(0.0, x=-30.0, y=0.0)


def paths(*users, ego=FAR, others=None, **changes):
    given = np.full((len(users), STATES, 3), np.nan) if others is None else others
    return IdmTraffic(road(), users, given, **changes)(ego)


def test_a_vehicle_is_put_onto_its_centreline_and_drives_along():
    [path] = paths(user(20.0, y=1.6, speed=8.0))
    np.testing.assert_allclose(path[:, 1:], 0.0, atol=1e-12)
    assert path[0, 0] == pytest.approx(20.0)
    speed = np.diff(path[:, 0]) / 0.1
    assert speed[0] == pytest.approx(8.0)
    assert np.all(np.abs(np.diff(speed)) <= 0.2 + 1e-9)  # 1 and 2 m/s^2


def test_the_first_step_is_the_drivers_formula():
    """A barrier, whose near end is 14 m ahead of the agent's front bumper."""
    barrier = user(38.0, kind=AgentKind.STATIC, token="s")
    given = np.tile(barrier.pose, (2, STATES, 1))
    path, _ = paths(user(20.0, speed=5.0), barrier, others=given)
    desired = 1.0 + 5.0 * 1.5 + 5.0 * 5.0 / (2 * np.sqrt(1.0 * 2.0))
    acceleration = 1.0 * (1 - (5.0 / 15.0) ** 4 - (desired / 14.0) ** 2)
    speed = np.diff(path[:3, 0]) / 0.1
    assert speed[1] - speed[0] == pytest.approx(0.1 * acceleration)


def test_a_vehicle_stops_behind_an_ego_that_stands():
    [behind] = paths(user(-10.0, speed=8.0), ego=straight(0.0, x=25.0))
    [free] = paths(user(-10.0, speed=8.0), ego=straight(0.0, x=25.0, y=3.5))
    rear = 25.0 - 1.127
    assert behind[-1, 0] + 2.0 < rear
    assert behind[-1, 0] < free[-1, 0]


def test_it_follows_a_vehicle_that_drives():
    first, second = paths(user(40.0, speed=6.0, token="a"), user(20.0, speed=8.0, token="b"))
    alone, _ = paths(user(20.0, speed=8.0, token="b"), user(190.0, speed=6.0, token="a"))
    assert np.all(first[:, 0] - second[:, 0] > 4.0)
    assert second[-1, 0] < alone[-1, 0] - 1.0


def test_a_red_connector_ends_the_path():
    going = user(CROSSING[0] - 20.0, speed=9.0)
    ego = straight(0.0, x=60.0, y=3.5)
    [green] = paths(going, ego=ego)
    [red] = paths(going, ego=ego, red={"across"})
    assert green[-1, 0] > CROSSING[0]
    assert red[-1, 0] <= CROSSING[0]


@pytest.mark.parametrize(
    ("who", "there"),
    [
        (user(20.0, y=-9.0), True),  # parked beside the lanes
        (user(20.0, y=-9.0, speed=3.0), False),  # drives where there is no lane
        (user(-30.0 + 1.461), False),  # would stand on the ego
        (user(-30.0 + 200.0, speed=3.0), False),  # further than 100 m away
    ],
)
def test_who_is_there(who, there):
    [path] = paths(who)
    assert bool(np.isfinite(path).all()) is there
    if there:
        np.testing.assert_array_equal(path, np.tile(who.pose, (STATES, 1)))
    else:
        assert np.isnan(path).all()


def test_of_two_that_overlap_the_second_is_left_out():
    first, second = paths(user(20.0, speed=3.0, token="a"), user(22.0, y=0.5, speed=3.0, token="b"))
    assert np.isfinite(first).all()
    assert np.isnan(second).all()


def test_others_go_as_given():
    walker = user(40.0, y=2.0, kind=AgentKind.PEDESTRIAN, size=(0.6, 0.6), token="p")
    given = np.full((2, STATES, 3), np.nan)
    given[1] = np.linspace([40.0, 2.0, 0.0], [40.0, -2.0, 0.0], STATES)
    car, seen = paths(user(20.0, speed=6.0), walker, others=given)
    np.testing.assert_array_equal(seen, given[1])
    assert car[-1, 0] + 2.0 < 40.0  # it waits


def test_an_oncoming_vehicle_follows_its_own_lane():
    coming = Obstacle(
        "o",
        AgentKind.VEHICLE,
        np.array([60.0, 3.0, np.pi]),
        np.array([-7.0, 0.0]),
        np.array([4.0, 2.0]),
    )
    [path] = paths(coming)
    np.testing.assert_allclose(path[:, 1], 3.5, atol=1e-9)
    assert path[-1, 0] < 40.0


def test_nobody_runs_into_another():
    rng = np.random.default_rng(5)
    x = -45.0 + np.cumsum(rng.uniform(6.0, 20.0, 8))
    users = [user(a, speed=rng.uniform(0.0, 6.0), token=str(i)) for i, a in enumerate(x)]
    found = paths(*users, ego=straight(3.0, x=-30.0, y=3.5))
    for i in range(len(users) - 1):
        overlap = boxes.bev_overlap_area(found[i], (4.0, 2.0), found[i + 1], (4.0, 2.0))
        assert np.all(overlap[~np.isnan(overlap)] == 0.0)


def test_a_plan_is_scored_among_vehicles_that_react():
    """A vehicle from behind stops behind an ego that plans to stand."""
    behind = user(-20.0, speed=9.0)
    traffic = IdmTraffic(road(), (behind,), np.full((1, STATES, 3), np.nan))
    here = PlanSituation(
        straight(3.0, x=10.0)[0], road(), ("ahead", "across", "beyond"), (behind,), traffic
    )
    found = score_plan(here, np.zeros((40, 3)))
    assert found.scores.no_collision == 1.0
    assert traffic(found.states)[0, -1, 0] + 2.0 < found.states[-1, 0] - 1.127
