"""The driver model, behind a lead and on a free road."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast import dynamics
from recast.dynamics.state import NUPLAN_PLANNER


def drive(state, target, stop=np.inf, steps=300):
    states = [np.asarray(state, float)]
    for _ in range(steps):
        states.append(dynamics.free_road_step(states[-1], target, stop))
    return np.array(states)


def test_settles_behind_a_lead_at_the_equilibrium_gap():
    parameters = NUPLAN_PLANNER
    state, lead = np.array([0.0, 12.0]), np.array([60.0, 6.0, 2.0])
    for _ in range(1200):
        state = dynamics.idm_step(state, lead, 13.0, parameters)
        lead[0] += 0.6
    gap = lead[0] - lead[2] - state[0]
    wanted = (1.0 + 6.0 * 1.5) / np.sqrt(1 - (6.0 / 13.0) ** 4)
    assert state[1] == pytest.approx(6.0, abs=1e-3)
    assert gap == pytest.approx(wanted, abs=1e-2)


def test_acceleration_is_bounded():
    speed = np.linspace(0, 30, 61)
    found = dynamics.idm_acceleration(speed, 10.0, 0.1, 0.0)
    assert found.min() == -3.0 and found.max() <= 1.0


def test_free_road_reaches_the_target_and_holds_it():
    states = drive([0.0, 3.0], 8.0)
    assert states[-1, 1] == pytest.approx(8.0, abs=1e-2)
    assert np.all(np.diff(states[:, 1]) >= 0)


def test_zero_target_brakes_to_a_standstill():
    states = drive([0.0, 5.0], 0.0, steps=40)
    assert states[-1, 1] == 0.0
    assert states[20, 1] == 0.0  # 5 m/s at 2.5 m/s^2: two seconds
    assert states[19, 1] > 0.0


@settings(max_examples=20, deadline=None)
@given(st.floats(0.5, 15), st.floats(0.5, 15), st.floats(0.0, 80.0))
def test_the_stop_point_is_never_passed(speed, target, stop):
    states = drive([0.0, speed], target, stop, steps=1650)
    assert states[:, 0].max() <= stop
    assert states[:, 1].min() >= 0
    assert states[-1, 1] == 0 and states[-1, 0] == states[-2, 0]
    assert stop - states[-1, 0] < 0.5


def test_oncoming_b_of_the_paper_stops_at_25_metres():
    states = drive([0.0, 6.0], 6.0, 25.0)
    assert 24.5 < states[-1, 0] <= 25.0
    moving = states[states[:, 1] > 0]
    assert np.diff(moving[:, 1]).min() / 0.1 >= -2.5  # foreseen, hence gentle


def test_batch_equals_single():
    states, targets, stops = np.array([[0.0, 3.0], [2.0, 5.0]]), [6.0, 0.0], [np.inf, 9.0]
    together = dynamics.free_road_step(states, targets, stops)
    for i in range(2):
        np.testing.assert_array_equal(
            dynamics.free_road_step(states[i], targets[i], stops[i]), together[i]
        )
