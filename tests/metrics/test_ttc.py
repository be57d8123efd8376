"""TTC."""

import numpy as np
import pytest

from recast.metrics import driving

SIZE = [5.0, 2.0]


def plan(speed):
    waypoints = np.zeros((1, 40, 3))
    waypoints[0, :, 0] = speed * 0.1 * np.arange(1, 41)
    return waypoints


def against(actor, speed, future=driving.realised_future):
    actor = np.asarray(actor, float)
    return driving.time_to_collision(
        np.zeros((1, 3)), plan(speed), SIZE, 0.0, future(actor, [0]), SIZE, [0]
    )


def standing(x, states=161):
    return np.tile([x, 0.0, 0.0, 0.0], (states, 1))


@pytest.mark.parametrize(
    ("gap", "speed", "wanted"),
    [(7.05, 10.0, 0.8), (6.99, 10.0, 0.7), (-1.0, 10.0, 0.0), (38.95, 10.0, 3.9), (39.05, 10, 4.0)],
)
def test_first_waypoint_that_overlaps(gap, speed, wanted):
    assert against(standing(5.0 + gap), speed).ttc.value == wanted


def test_values_are_exact_tenths():
    value = against(standing(7.95), 10.0).ttc.value
    assert value == 0.3 and repr(value) == "0.3"


def test_realised_and_constant_velocity_differ_where_the_actor_stops():
    times = 0.1 * np.arange(161)
    actor = np.zeros((161, 4))
    actor[:, 0] = 30 - np.minimum(5 * times, 5.0)  # towards the ego for one second
    actor[:, 2] = np.pi
    actor[times < 1.0, 3] = 5.0
    assert against(actor, 5.0).ttc.value == 4.0  # standing at 25 m, the ego reaches 22.5 m
    assert against(actor, 5.0, driving.constant_velocity_future).ttc.value == 2.6


def test_past_the_last_state_the_actor_keeps_its_velocity():
    actor = np.zeros((11, 4))
    actor[:, 0] = 28.0 - 0.5 * np.arange(11)
    actor[:, 2], actor[:, 3] = np.pi, 5.0
    future = driving.realised_future(actor, [0, 8])
    np.testing.assert_allclose(future[0, :, 0], 28.0 - 0.5 * np.arange(40))
    np.testing.assert_allclose(future[1, :, 0], 24.0 - 0.5 * np.arange(40))


def test_an_actor_in_reverse_is_continued_backwards():
    actor = np.zeros((11, 4))
    actor[:, 0], actor[:, 3] = -0.2 * np.arange(11), 2.0
    future = driving.constant_velocity_future(actor, [0, 10])
    np.testing.assert_allclose(future[:, 10, 0], [-2.0, -4.0])


def test_without_plans_there_is_no_value():
    future = driving.realised_future(standing(20.0), np.zeros(0, int))
    result = driving.time_to_collision(
        np.zeros((0, 3)), np.zeros((0, 40, 3)), SIZE, 0.0, future, SIZE, []
    )
    assert not result.ttc.valid


def test_reason_names_the_plan():
    assert "step 0 (0.0 s) meets the actor after 0.8 s" in against(standing(12.05), 10.0).ttc.reason
    assert against(standing(100.0), 10.0).ttc.reason is None
