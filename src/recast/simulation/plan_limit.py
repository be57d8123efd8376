"""Asking a planner for its plan: in time, if there is a limit, and checked."""

from __future__ import annotations

import contextvars
import threading
from time import perf_counter

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
