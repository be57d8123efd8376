"""Asking a planner for its plan, in time and checked, and driving the ego along its waypoints."""

from __future__ import annotations

import contextvars
import threading
from dataclasses import dataclass
from time import perf_counter
from typing import Protocol

from recast.arrays import Array
from recast.dynamics import (
    PRESETS,
    TrackerConfig,
    VehicleParameters,
    follow_perfectly,
    plan_to_poses,
    track,
)
from recast.dynamics import state as ego
from recast.planning import Plan, Planner, PlannerInput


def ask(planner: Planner, observation: PlannerInput, limit_s: float | None) -> tuple[Plan, float]:
    """A planner's plan, and the seconds of wall-clock time that it took.

    With a limit the planner runs in a thread of its own. A planner that does not answer in time is
    left alone there: the thread ends with the process.

    Raises:
        ValueError: the answer is no plan, or took too long; names the planner and the step.
        Exception: whatever the planner raises.
    """
    began = perf_counter()
    plan = planner.plan(observation) if limit_s is None else _in_time(planner, observation, limit_s)
    took = perf_counter() - began
    if limit_s is not None and took > limit_s:
        raise ValueError(
            f"planner {planner.name}: took {took:.3g} s for the plan at step {observation.step}, "
            f"the limit is {limit_s:g} s"
        )
    return checked_plan(plan, f"planner {planner.name}"), took


def checked_plan(plan: object, who: str, verb: str = "returned") -> Plan:
    """A plan that can be executed.

    Raises:
        ValueError: it is none; one line that begins with `who` and `verb`.
    """
    if not isinstance(plan, Plan):
        raise ValueError(f"{who}: {verb} {type(plan).__name__}, not a Plan")
    try:
        plan.validate()
    except ValueError as error:
        raise ValueError(f"{who}: {error}") from None
    return plan


def _in_time(planner: Planner, observation: PlannerInput, limit_s: float) -> object:
    answers: list[object] = []
    faults: list[BaseException] = []

    def run() -> None:
        try:
            answers.append(planner.plan(observation))
        except BaseException as error:
            faults.append(error)

    context = contextvars.copy_context()
    thread = threading.Thread(
        target=context.run, args=(run,), name=f"planner {planner.name}", daemon=True
    )
    thread.start()
    thread.join(min(limit_s, threading.TIMEOUT_MAX))
    if faults:
        raise faults[0]
    if not answers:
        raise ValueError(
            f"planner {planner.name}: gave no plan at step {observation.step} within the limit of "
            f"{limit_s:g} s"
        )
    return answers[0]


class EgoController(Protocol):
    """Executes the first waypoints of a plan."""

    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Ego states (steps + 1, 11), the given one (11,) first.

        Args:
            waypoints: (40, 3) waypoints in the ego frame of `state`, `dt` apart.
            steps: how many steps to execute.
            vehicle: the ego.
            dt: seconds per step, and between waypoints.
        """


@dataclass(frozen=True)
class LqrController:
    """nuPlan's LQR tracker and kinematic bicycle with actuator lag.

    The paper says that the ego controller executes the first K waypoints, not which controller it
    is. We take the tracker of the benchmark that the published planners were made for.
    """

    config: TrackerConfig = PRESETS["default"]

    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Fit the plan's profiles once and track them; see `recast.dynamics.track`."""
        poses = plan_to_poses(state[ego.POSE], waypoints)
        return track(state, poses, steps, self.config, vehicle, dt)


@dataclass(frozen=True)
class PerfectController:
    """Puts the ego onto the waypoints: shows what the plans alone would do."""

    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Jump from waypoint to waypoint; speeds and rates are their differences."""
        poses = plan_to_poses(state[ego.POSE], waypoints)
        return follow_perfectly(state, poses, steps, vehicle, dt)
