"""NeuroNCAP's score by hand; docs/metrics.md has the same numbers."""

from __future__ import annotations

import numpy as np
import pytest

from recast.geometry import se2
from recast.simulation.rollout import ControlledActor
from recast_bridges.scores.simulators import neuroncap_mean, neuroncap_score
from support.made_up_rollouts import make_rollout


def coming(x, speed, states=81, y=0.0):
    """An actor that comes towards the ego at `speed`."""
    path = np.tile([x, y, np.pi, speed], (states, 1))
    path[:, 0] -= speed * 0.1 * np.arange(states)
    return path


def braking(start, deceleration, states=81):
    """An ego that brakes to a halt, and the recorded one that does not."""
    times = 0.1 * np.arange(states)
    halt = start / deceleration
    moving = np.minimum(times, halt)
    ego = np.zeros((states, 11))
    ego[:, 0] = start * moving - deceleration * moving**2 / 2
    ego[:, 3] = start - deceleration * moving
    log = np.zeros((states, 4))
    log[:, 0], log[:, 3] = start * times, start
    return {"ego": ego, "log_ego": log}


def test_without_a_collision_there_are_five_stars():
    found = neuroncap_score(make_rollout(**braking(10.0, 4.0), actor=coming(60.0, 0.0)))
    assert (found.score.value, found.impact_speed, found.collides) == (5.0, None, False)
    assert found.reference_speed == pytest.approx(10.0)


def test_what_is_left_of_the_speed_costs_stars():
    # The gap to the rear at 17.75 m is 13.70 m. Braking with 3 m/s^2 takes the ego to 10^2 - 2 * 3
    # * 13.70 = 4.2^2 m^2/s^2 there; the first step after it is at 2.0 s, at 4.0 m/s.
    found = neuroncap_score(make_rollout(**braking(10.0, 3.0), actor=coming(20.0, 0.0)))
    assert found.impact_speed == pytest.approx(4.0)
    assert found.score.value == pytest.approx(4 * (1 - 4.0 / 10.0))
    assert found.score.reason == "hits the actor at step 20 at 4.0 m/s (reference 10.0 m/s)"


def test_no_reaction_scores_nothing():
    found = neuroncap_score(make_rollout(speed=10.0, steps=80, actor=coming(60.0, 3.0)))
    assert found.impact_speed == pytest.approx(13.0)
    assert found.reference_speed == pytest.approx(13.0)
    assert found.score.value == pytest.approx(0.0, abs=1e-12)


def test_an_ego_that_speeds_up_has_no_less_than_nothing():
    made = braking(10.0, 1.0)
    made["log_ego"][:, 0] /= 2  # the recorded one was slower
    assert neuroncap_score(make_rollout(**made, actor=coming(20.0, 0.0))).score.value == 0.0


def test_the_code_takes_the_speed_at_the_end_of_the_recording():
    made = braking(10.0, 3.0)
    made["log_ego"][60:, 0] = made["log_ego"][60, 0]  # it stood at the end
    made["log_ego"][75:, 0] += 0.5 * 0.1 * np.arange(1, 7)  # and crept on, at 0.5 m/s
    rollout = make_rollout(**made, actor=coming(20.0, 0.0))
    assert neuroncap_score(rollout).reference_speed == pytest.approx(10.0)
    assert neuroncap_score(rollout, "log-end").reference_speed == pytest.approx(0.5)
    assert neuroncap_score(rollout, "log-end").score.value == 0.0


def test_the_first_actor_that_is_met_counts():
    path = coming(12.0, 2.0)
    other = ControlledActor(
        "8", "car", "oncoming", "a", path, se2.to_se3(path[:, :3], 0.8), np.array([4.5, 1.9, 1.6])
    )
    rollout = make_rollout(**braking(10.0, 3.0), actor=coming(20.0, 0.0), controlled=(other,))
    found = neuroncap_score(rollout)
    # 5.70 m apart: after 0.5 s 5.63 m are covered together, after 0.6 s 6.66 m. The ego has 8.2 m/s
    # left then.
    assert found.impact_speed == pytest.approx(8.2 + 2.0)
    assert found.score.reason.startswith("hits actor 8 at step 6")
    assert found.reference_speed == pytest.approx(10.0)  # the target's


def test_without_a_reference_there_is_no_value_after_a_collision():
    made = braking(10.0, 3.0)
    made["log_ego"][:, 0] = 0.0
    found = neuroncap_score(make_rollout(**made, actor=coming(20.0, 0.0)))
    assert found.score.value is None
    assert found.to_json()["any_collide"]


def test_a_short_rollout_takes_its_last_step():
    short = make_rollout(**braking(10.0, 3.0, states=11), actor=coming(60.0, 1.0, states=11))
    assert neuroncap_score(short).reference_speed == pytest.approx(11.0)


def test_the_mean_is_over_runs_then_sequences_then_categories():
    scores = {"frontal": {"a": [5.0, 1.0], "b": [0.0]}, "side": {"c": [4.0]}}
    assert neuroncap_mean(scores) == pytest.approx(((3.0 + 0.0) / 2 + 4.0) / 2)
