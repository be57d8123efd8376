"""Motion primitives: physics, mirror, and a planner that chooses from them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.core.errors import InputError
from recast.dynamics import make_state, plan_to_poses, track
from recast.dynamics import state as ego
from recast.dynamics.tracker import comfortable_plans
from recast.metrics.driving import com_driven
from recast.planning import DrivingCommand, PlannerInput
from recast.planning.gtrs import GtrsPlanner, load_gtrs, save_gtrs
from recast.planning.gtrs.config import (
    PRIMITIVES,
    MotionPrimitives,
    Pace,
    PrimitivePath,
)
from recast.planning.gtrs.planner import GtrsDecision
from recast.planning.gtrs.scores import VOCABULARY_ONLY, comfortable
from recast.planning.types import ego_status

SPEEDS = st.floats(0.0, 16.0)
RATES = st.floats(-4.0, 2.0)
BENDS = st.floats(-3.0, 3.0)  # m/s^2 of lateral acceleration


def status(speed: float, rate: float = 0.0, sideways: float = 0.0) -> np.ndarray:
    return np.array([[0, 1, 0, 0, speed, 0, rate, sideways]], np.float32)


def speeds(trajectories: np.ndarray) -> np.ndarray:
    steps = np.diff(np.pad(trajectories[..., :2], ((0, 0), (1, 0), (0, 0))), axis=1)
    return 10 * np.linalg.norm(steps, axis=-1)


@settings(deadline=None, max_examples=40)
@given(SPEEDS, RATES, BENDS)
def test_the_mirrored_bend_gives_the_mirrored_primitives(
    speed: float, rate: float, sideways: float
) -> None:
    here = PRIMITIVES.trajectories(status(speed, rate, sideways))[0]
    there = PRIMITIVES.trajectories(status(speed, rate, -sideways))[0]
    np.testing.assert_array_equal(there[PRIMITIVES.mirror] * np.float32([1, -1, -1]), here)
    np.testing.assert_array_equal(PRIMITIVES.mirror[PRIMITIVES.mirror], np.arange(len(PRIMITIVES)))


@settings(deadline=None, max_examples=40)
@given(SPEEDS, RATES, BENDS)
def test_they_begin_as_the_ego_moves_and_can_be_driven(
    speed: float, rate: float, sideways: float
) -> None:
    found = PRIMITIVES.trajectories(status(speed, rate, sideways))[0].astype(np.float64)
    driven = speeds(found)
    # The mean of the first step lies half a step on; braking at 6 m/s^2 changes 0.3 m/s until then.
    assert np.abs(driven[:, 0] - speed).max() <= 0.05 * 6.0 + 1e-3
    change = 10 * np.diff(driven, axis=1)
    assert change.min() > -6.1
    assert change.max() < 2.5
    # The rear axle moves along its heading: a step's chord leads to its middle.
    poses = np.pad(found, ((0, 0), (1, 0), (0, 0)))
    moved = np.diff(poses[..., :2], axis=1)
    middle = (poses[:, 1:, 2] + poses[:, :-1, 2]) / 2
    aside = moved[..., 1] * np.cos(middle) - moved[..., 0] * np.sin(middle)
    assert np.abs(aside).max() < 0.02


@pytest.mark.parametrize("speed", [3.0, 8.0, 13.0])
def test_stops_are_as_long_as_physics_says_and_most_are_comfortable(speed: float) -> None:
    found = PRIMITIVES.trajectories(status(speed))[0]
    rates = np.array([PRIMITIVES.paces[i].acceleration for i, _ in PRIMITIVES.entries])
    late = np.array([PRIMITIVES.paces[i].begins > 0 for i, _ in PRIMITIVES.entries])
    straight = np.abs(found[:, -1, 1]) < 1e-3
    for rate, jerk in ((-6.0, 7.0), (-4.0, 7.0)):
        (row,) = np.flatnonzero((rates == rate) & straight & ~late)[:1]
        ideal = speed**2 / (2 * -rate)
        # It builds up within rate / jerk seconds, at the speed before, and ends about as gently.
        assert ideal < found[row, -1, 0] < ideal + speed * -rate / jerk + 0.5
    assert comfortable_plans(found).mean() > 0.75
    cruise = np.flatnonzero((rates == 0.0) & straight)[0]
    assert found[cruise, -1, 0] == pytest.approx(4.0 * speed, rel=1e-5)


def test_standing_still_is_among_them() -> None:
    found = PRIMITIVES.trajectories(status(0.0))[0]
    assert not found[0].any()
    assert found[:, -1, 0].max() > 10.0


def test_a_planner_of_primitives_is_read_as_it_was_written(
    planner: GtrsPlanner, observation: PlannerInput, tmp_path: Path
) -> None:
    mine = GtrsPlanner(planner.model, PRIMITIVES, planner.views, name="mine")
    save_gtrs(tmp_path / "mine", mine)
    assert not (tmp_path / "mine" / "vocabulary.npy").exists()
    again = load_gtrs(tmp_path / "mine")
    assert again.vocabulary == PRIMITIVES
    decision = again.decide(observation)
    assert decision.trajectories.shape == (len(PRIMITIVES), 40, 3)
    np.testing.assert_array_equal(
        again.plan(observation).waypoints, decision.trajectories[decision.best].astype(np.float64)
    )


def test_what_is_near_the_best_is_blended_in(
    planner: GtrsPlanner, observation: PlannerInput
) -> None:
    """A small blend is the best alone, a large one the mean of all by their scores."""
    decision = GtrsPlanner(planner.model, PRIMITIVES, planner.views).decide(observation)
    best = decision.trajectories[decision.best]
    np.testing.assert_array_equal(decision.driven(0.0), best.astype(np.float64))
    twice = np.concatenate([decision.trajectories, best[None] * np.float32([1, 1, 0.5])])
    scores = np.append(decision.scores, decision.scores.max())
    same_end = replace(decision, trajectories=twice, scores=scores)
    np.testing.assert_array_equal(same_end.driven(0.0), best.astype(np.float64))
    weights = np.exp(decision.scores - decision.scores.max()).astype(np.float64)
    mean = np.average(decision.trajectories, axis=0, weights=weights)
    np.testing.assert_allclose(decision.driven(1e3), mean, atol=1e-4)
    weights = VOCABULARY_ONLY.model_copy(update={"blended": 1e3})
    blends = GtrsPlanner(planner.model, PRIMITIVES, planner.views, weights=weights)
    np.testing.assert_allclose(blends.plan(observation).waypoints, mean, atol=1e-4)


def test_paces_are_blended_and_swerves_are_not() -> None:
    """Three paces of a bend, and one as long that ends in the next lane; of a bad score nothing."""
    length, bend = np.array([40.0, 34.0, 28.0, 40.0, 38.0]), np.linspace(0.0, 1.0, 41)[1:]
    x = length[:, None] * bend
    y = 0.004 * x**2 + np.array([0.0, 0.0, 0.0, 3.6, 0.0])[:, None] * bend
    trajectories = np.stack([x, y, 0.008 * x], axis=2).astype(np.float32)
    scores = np.array([0.0, -0.5, -1.0, -0.1, -50.0], np.float32)
    weights = np.exp([0.0, -0.5, -1.0])
    mean = np.average(trajectories[:3], axis=0, weights=weights)
    decision = GtrsDecision(trajectories, scores, {})
    np.testing.assert_allclose(decision.driven(12.5), mean, atol=1e-5)
    calm = np.array([True, True, False, True, True])
    np.testing.assert_array_equal(replace(decision, calm=calm).driven(12.5), decision.driven(12.0))
    np.testing.assert_array_equal(replace(decision, calm=~calm).driven(12.5), decision.driven(12.5))
    weights[2] = 0.0  # ends 12.4 m behind
    mean = np.average(trajectories[:3], axis=0, weights=weights)
    np.testing.assert_allclose(decision.driven(12.0), mean, atol=1e-5)
    standing, along, beside = np.zeros((3, 40, 3), np.float32)
    along[:, 0] = beside[:, 1] = np.linspace(0.0, 0.1, 40)
    decision = GtrsDecision(np.stack([standing, along, beside]), np.zeros(3, np.float32), {})
    np.testing.assert_allclose(decision.driven(0.2), along / 2.0, atol=1e-7)


def test_paths_without_a_mirror_image_and_nothing_to_combine_are_refused() -> None:
    path = PrimitivePath(kind="shift", by=1.0, main=True)
    lonely = MotionPrimitives(paces=(Pace(acceleration=0.0),), paths=(path,))
    with pytest.raises(InputError, match="no mirror image"):
        _ = lonely.mirror
    with pytest.raises(ValueError, match="nothing is combined"):
        MotionPrimitives(
            paces=(Pace(acceleration=0.0),), paths=(path.model_copy(update={"main": False}),)
        )


def test_smoothly_begun_plans_are_driven_comfortably() -> None:
    """What the tracker makes of them, against what is told from the plan and the state alone."""
    rng = np.random.default_rng(0)
    told, driven = [], []
    for _ in range(12):
        speed = rng.uniform(2.0, 15.0)
        rate = float(np.clip(rng.normal(0.0, 1.2), -3.5, 1.8))
        state = make_state(np.zeros(3), speed, rate, speed * rng.normal(0.0, 0.01))
        now = ego_status(DrivingCommand.STRAIGHT, state)
        plans = PRIMITIVES.trajectories(now[None])[0]
        start = np.broadcast_to(state, (len(plans), ego.SIZE))
        states = track(start, plan_to_poses(start[:, ego.POSE], plans.astype(np.float64)), 40)
        told.append(comfortable(plans, now))
        driven.append([com_driven(one).com.value == 1.0 for one in states])
    agree = np.concatenate(told) == np.concatenate(driven)
    assert agree.mean() > 0.85
    assert 0.3 < np.mean(np.concatenate(told)) < 0.8


@pytest.mark.parametrize("speed", [8.0, 13.0])
def test_hard_braking_can_be_driven_comfortably(speed: float) -> None:
    """With a new plan every half second, from steady driving to a standstill."""

    def followed(pace: int) -> np.ndarray:
        (row,) = np.flatnonzero((PRIMITIVES.entries == (pace, 0)).all(axis=1))
        states = [make_state(np.zeros(3), speed)]
        for _ in range(12):
            now = ego_status(DrivingCommand.STRAIGHT, states[-1])
            plan = PRIMITIVES.trajectories(now[None])[0, row].astype(np.float64)
            states.extend(track(states[-1], plan_to_poses(states[-1][ego.POSE], plan), 5)[1:])
        return np.array(states)

    hard = [i for i, one in enumerate(PRIMITIVES.paces) if one.acceleration == -4.0]
    at_once, gently = (
        next(followed(i) for i in hard if (PRIMITIVES.paces[i].jerk is None) is usual)
        for usual in (True, False)
    )
    assert com_driven(at_once).com.value == 0.0
    assert com_driven(gently).com.value == 1.0
    longer = gently[-1, ego.X] - at_once[-1, ego.X]
    assert 0.0 < longer < 0.7 * speed
