"""How far a rollout is from failing, and what its scenario asks of a driver."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.metrics import rollout_metrics
from recast.metrics.rollout_metrics import least_gaps
from recast.planning import WAYPOINTS, BasePlanner, ConstantVelocity, Plan, PlannerInput
from recast.simulation import MOTIONS, RolloutSetup, run_rollout
from recast.simulation.motions import Idm, Oncoming, Stationary
from recast.simulation.setup import PerfectController
from recast.studies.designs import next_along, parse_axis
from recast.studies.trials import (
    HARD,
    LEVELS,
    REACTION,
    difficulty,
    hardest_braking,
    measured,
    parse_objective,
)
from support.synthetic_drives import drive

SPEED = 10.0


def standing(gap: float) -> Stationary:
    return Stationary("x", min_gap=gap, braking=20.0, reserve=0.0)


def setup_of(motion: Any, steps: int = 80, **more: Any) -> RolloutSetup:
    return RolloutSetup(drive(SPEED, 30.0), "7", motion, steps=steps, **more)


class Braking(BasePlanner):
    """Brakes from the start on, with a constant deceleration."""

    name = "braking"
    needs_images = False

    def __init__(self, deceleration: float) -> None:
        self._a = deceleration

    def plan(self, observation: PlannerInput) -> Plan:
        now = 0.1 * observation.step  # of the clock: what a controller makes of it must not add up
        waypoints = np.zeros((WAYPOINTS, 3))
        waypoints[:, 0] = self._driven(now + 0.1 * np.arange(1, WAYPOINTS + 1)) - self._driven(now)
        return Plan(waypoints)

    def _driven(self, times: Any) -> Any:
        until = np.minimum(times, SPEED / self._a)
        return SPEED * until - self._a * until**2 / 2


def margin_of(motion: Any, planner: BasePlanner, objective: str = "at-fault") -> float | None:
    setup = setup_of(motion, controller=PerfectController())
    return parse_objective(objective).margin(rollout_metrics(run_rollout(setup, planner), None))


def test_the_margin_is_what_is_left_or_what_braking_lacked() -> None:
    free = margin_of(standing(60.0), Braking(4.0))
    assert free == pytest.approx(60.0 - SPEED**2 / 8, abs=0.05)
    # At the contact it still has v^2 = 100 - 2 * 4 * 9.
    hit = margin_of(standing(9.0), Braking(4.0))
    assert hit == pytest.approx(-(SPEED**2 - 72) / (2 * HARD), abs=0.7)  # contacts are of steps
    assert hit is not None and hit < 0


@pytest.mark.parametrize("deceleration", [2.5, 4.0, 6.0])
def test_a_known_boundary_is_found_within_five_centimetres(deceleration: float) -> None:
    """Who brakes from the start on stops after v^2 / 2a."""
    axis = parse_axis("gap=5:40")
    known: dict[float, float | None] = {}
    while len(known) < 9:
        gap = next_along(axis, known)
        known[gap] = margin_of(standing(gap), Braking(deceleration))
    low = max(gap for gap, margin in known.items() if margin is not None and margin < 0)
    high = min(gap for gap, margin in known.items() if margin is not None and margin >= 0)
    at_low, at_high = known[low] or 0.0, known[high] or 0.0
    found = low + (high - low) * at_low / (at_low - at_high)
    assert found == pytest.approx(SPEED**2 / (2 * deceleration), abs=0.05)


def test_a_contact_without_blame_is_not_one_at_fault() -> None:
    through = Oncoming("x", gap=40.0, speed=6.0)  # hits an ego that stands
    assert margin_of(through, Braking(6.0)) == 0.0
    collides = margin_of(through, Braking(6.0), "collision")
    assert collides == pytest.approx(-(6.0**2) / (2 * HARD), abs=1e-6)


def test_thresholds_of_measures_are_objectives() -> None:
    setup = setup_of(standing(30.0), controller=PerfectController())
    metrics = rollout_metrics(run_rollout(setup, Braking(4.0)), None)
    values = measured(metrics)
    assert values["distance"] == pytest.approx(17.5, abs=0.05)
    assert values["braking"] == pytest.approx(4.0, abs=0.1)
    assert parse_objective("distance<10").margin(metrics) == pytest.approx(7.5, abs=0.05)
    assert parse_objective("braking>3").margin(metrics) == pytest.approx(-1.0, abs=0.1)
    assert parse_objective("r_c<0.5").margin(metrics) == pytest.approx((values["r_c"] or 0) - 0.5)


@pytest.mark.parametrize("text", ["", "crash", "ttc", "ttc=1", "speed<3", "ttc<one", "ttc<1;2"])
def test_a_wrong_objective_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="is not known; choose at-fault or collision"):
        parse_objective(text)


@pytest.mark.parametrize("gap", [12.0, 15.0, 25.0, 50.0])
def test_a_standing_car_asks_for_the_braking_of_the_textbook(gap: float) -> None:
    asked = difficulty(setup_of(standing(gap)))
    needed = SPEED**2 / (2 * (gap - SPEED * REACTION))
    assert asked.noticed == 0.0
    if needed > LEVELS[-1]:
        assert asked.braking is None and not asked.fair
    else:
        assert asked.braking is not None
        assert needed - 1e-6 <= asked.braking <= needed + 0.25 + 1e-6
        assert asked.fair == (asked.braking <= HARD)


def test_who_passes_in_the_next_lane_asks_for_nothing() -> None:
    asked = difficulty(setup_of(MOTIONS["advancing-a"]))
    assert (asked.noticed, asked.braking, asked.fair) == (None, 0.0, True)


def test_a_car_that_cuts_in_is_noticed_when_it_comes_over() -> None:
    motion = replace(MOTIONS["cut-in-a"], gap=20.0, delay=1.5)  # type: ignore[type-var]
    asked = difficulty(setup_of(motion))
    assert asked.noticed is not None and 1.4 < asked.noticed < 3.5
    assert asked.braking is not None and 0.0 < asked.braking <= HARD


def test_a_lane_change_may_save_who_cannot_brake() -> None:
    """The map has none, so the traffic that was seen says where the next lane is."""
    slow = Stationary("x", min_gap=25.0, braking=20.0, reserve=0.0, lateral=0.0)
    asked = difficulty(setup_of(slow))
    assert asked.braking is not None and asked.braking == pytest.approx(2.5, abs=0.25)
    near = difficulty(setup_of(standing(8.0)))
    assert not near.lane_change and not near.fair


def test_an_actor_that_reacts_does_so_to_an_ego_that_keeps_its_speed() -> None:
    leading = Idm("x", speed=0.5, gap=30.0)
    asked = difficulty(setup_of(leading))
    assert asked.noticed == 0.0 and asked.braking is not None and 0.0 < asked.braking < 3.0


def test_distances_and_braking_of_a_rollout() -> None:
    rollout = run_rollout(setup_of(standing(30.0), steps=20), ConstantVelocity())
    assert least_gaps(rollout).min() == pytest.approx(10.0, abs=0.1)
    assert hardest_braking(rollout) < 0.1


def test_a_rollout_ends_with_the_plan_of_its_contact_and_means_the_same() -> None:
    motion, planner = standing(20.0), ConstantVelocity()
    whole = run_rollout(setup_of(motion), planner)
    short = run_rollout(setup_of(motion, end_on_contact=True), planner)
    metrics, ended = (rollout_metrics(one, None) for one in (whole, short))
    step = metrics.collision.first_step
    assert whole.steps_run == 80 and step is not None
    assert step <= short.steps_run < step + 5
    assert short.cut_reason is not None and "ended with the first contact, " in short.cut_reason
    np.testing.assert_array_equal(short.ego, whole.ego[: len(short.ego)])
    for text in ("at-fault", "collision"):
        objective = parse_objective(text)
        assert objective.margin(metrics) == objective.margin(ended)


def test_a_contact_at_once_leaves_two_plans() -> None:
    short = run_rollout(setup_of(standing(2.0), end_on_contact=True), ConstantVelocity())
    assert short.steps_run == 10
    assert run_rollout(setup_of(standing(200.0), end_on_contact=True), Braking(4.0)).steps_run == 80
