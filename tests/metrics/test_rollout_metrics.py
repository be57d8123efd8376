"""All metrics of a rollout together: what must hold whatever the numbers."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.geometry import se2
from recast.metrics import rollout_metrics
from support.made_up_rollouts import make_rollout, moved_map, moved_rollout, street

moves = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-4, 4))


def eventful_rollout(seed=0):
    """Curved driving into a slow actor, with noisy plans."""
    rng = np.random.default_rng(seed)
    ego = np.zeros((101, 11))
    heading = 0.002 * np.arange(101)
    ego[:, 2], ego[:, 3] = heading, 8.0
    ego[1:, :2] = np.cumsum(0.8 * np.stack([np.cos(heading), np.sin(heading)], -1)[:-1], axis=0)
    actor = np.zeros((101, 4))
    actor[:, 0], actor[:, 1], actor[:, 3] = 30 + 0.35 * np.arange(101), 2.0, 3.5
    plans = np.zeros((20, 40, 3))
    plans[..., 0] = 0.8 * np.arange(1, 41) * rng.uniform(0.3, 1.0, (20, 1))
    plans[..., 1] = rng.normal(0, 0.2, (20, 1)) * np.linspace(0, 1, 40)
    plans[::2, :, 0] += 0.01 * rng.normal(size=(10, 40))  # every other plan is jerky
    return make_rollout(ego, actor, plans)


def test_constant_waypoints_without_an_obstacle_are_perfect():
    metrics = rollout_metrics(make_rollout(), street())
    values = {name: metric.value for name, metric in metrics.values.items()}
    assert values["nc"] == values["dac"] == 1.0
    assert values["ttc"] == values["ttc_constant_velocity"] == 4.0
    assert values["com"] == values["com_4_13"] == values["com_nuplan_savgol"] == 1.0
    assert values["r_c"] == pytest.approx(0.8)


def test_the_eventful_rollout_is_eventful():
    values = rollout_metrics(eventful_rollout(), street()).values
    assert values["nc"].value == 0.0 and 0 < values["com"].value < 1
    assert values["ttc"].value == 0.0 and 0 < values["r_c"].value < 1


@settings(max_examples=10, deadline=None)
@given(moves)
def test_metrics_do_not_depend_on_the_world_frame(move):
    rollout, hd_map = eventful_rollout(), street(half_width=6.0)
    wanted = rollout_metrics(rollout, hd_map)
    found = rollout_metrics(moved_rollout(rollout, move), moved_map(hd_map, move))
    for name, metric in wanted.values.items():
        assert found.values[name].value == pytest.approx(metric.value, abs=1e-8), name
    assert found.collision.first_step == wanted.collision.first_step
    assert found.drivable.first_step == wanted.drivable.first_step
    np.testing.assert_array_equal(found.ttc.per_cycle, wanted.ttc.per_cycle)
    np.testing.assert_allclose(found.drivable.distance, wanted.drivable.distance, atol=1e-8)


@pytest.mark.parametrize("steps", [1, 4, 5, 37, 80, 160])
def test_any_length(steps):
    metrics = rollout_metrics(make_rollout(steps=steps), street())
    assert len(metrics.ttc.per_cycle) == len(metrics.plan_steps) == -(-steps // 5)
    assert metrics.collision.overlap.shape == (steps + 1,)
    assert metrics.ttc.ttc.value == 4.0 and metrics.comfort.com.value == 1.0


def test_a_head_on_plan_is_seen_beyond_the_end_of_a_short_rollout():
    """The actor's states are known for 1 s; the plans meet it after 2.4 s."""
    rollout = make_rollout(steps=10, speed=5.0)
    actor = np.zeros((11, 4))
    actor[:, 0], actor[:, 2], actor[:, 3] = 30 - 0.5 * np.arange(11), np.pi, 5.0
    metrics = rollout_metrics(replace(rollout, actor=actor), street())
    # bumpers are 30 - 4.049 - 2.25 m apart at the start and close at 10 m/s
    assert metrics.ttc.per_cycle.tolist() == [2.4, 1.9]


def test_without_a_map_only_dac_is_missing():
    metrics = rollout_metrics(make_rollout(), None)
    assert [name for name, metric in metrics.values.items() if not metric.valid] == ["dac"]
    json.dumps(metrics.to_json(), allow_nan=False)


def test_json_is_plain_and_repeatable():
    first, second = (
        json.dumps(rollout_metrics(eventful_rollout(), street(6.0)).to_json(), allow_nan=False)
        for _ in range(2)
    )
    assert first == second
    data = json.loads(first)
    step = data["per_step"]["first_collision_step"]
    assert data["per_step"]["overlap_steps"][0] == step
    assert f"step {step} " in data["metrics"]["nc"]["reason"]
    assert len(data["per_cycle"]["com_failed"]) == len(data["per_cycle"]["plan_steps"]) == 20


def test_the_first_steps_are_scored_as_a_rollout_that_ended_there():
    rollout = eventful_rollout()
    metrics, short = rollout_metrics(rollout, street()), rollout.first(12)
    assert (short.steps_run, short.plan_steps.tolist()) == (12, [0, 5, 10])
    assert len(short.predictions) == 3 and len(short.world_from_actor) == 13
    found = metrics.over(12)
    assert found.to_json() == rollout_metrics(short, street()).to_json()
    assert found.plans == 3 and found.steps_run == 12
    assert metrics.over(metrics.steps_run) is metrics
    for steps in (0, metrics.steps_run + 1):
        with pytest.raises(ValueError, match=r"Rollout\.first"):
            metrics.over(steps)


def test_the_ego_box_sits_ahead_of_the_rear_axle():
    """An actor just behind the rear bumper is not hit, one just before the front bumper is."""
    for x, hit in ((-1.127 - 2.26, False), (4.049 + 2.24, True)):
        rollout = make_rollout(steps=1, speed=0.0)
        actor = np.tile([x, 0.0, 0.0, 0.0], (2, 1))
        metrics = rollout_metrics(replace(rollout, actor=actor), None)
        assert (metrics.values["nc"].value == 0.0) == hit


def test_moved_rollout_helper_moves_the_ego():
    moved = moved_rollout(make_rollout(), (3.0, 4.0, np.pi / 2))
    np.testing.assert_allclose(moved.ego[0, :3], [3, 4, np.pi / 2])
    np.testing.assert_allclose(
        se2.relative([3, 4, np.pi / 2], moved.ego[-1, :3])[:2],
        make_rollout().ego[-1, :2],
        atol=1e-9,
    )
