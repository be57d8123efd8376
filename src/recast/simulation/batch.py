"""Many rollouts, of which one that fails becomes a row instead of ending the batch."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from recast.planning import Planner
from recast.simulation.renderer import SensorRenderer
from recast.simulation.rollout import Rollout, RolloutFailure
from recast.simulation.rollout_loop import OnFrame, Timings, run_rollout
from recast.simulation.setup import RolloutSetup

TRACEBACK_LIMIT = 8000
"""Characters of a traceback that a failure keeps: the last ones, which name the place."""
_REASON_LIMIT = 2000

OnDone = Callable[["RolloutJob", Rollout | RolloutFailure, Timings], None]


@dataclass(frozen=True)
class RolloutJob:
    """The arguments of one `run_rollout`."""

    setup: RolloutSetup
    planner: Planner
    renderer: SensorRenderer | None = None
    on_frame: OnFrame | None = None


def run_batch(
    jobs: Iterable[RolloutJob], on_done: OnDone | None = None
) -> list[Rollout | RolloutFailure]:
    """Run jobs one after the other.

    Args:
        on_done: called after each, for progress and for saving early.

    Returns:
        In the order of the jobs, a rollout or the reason why there is none. Only interrupts and
        errors of `on_done` end the batch.
    """
    results: list[Rollout | RolloutFailure] = []
    for job in jobs:
        timings = Timings()
        result: Rollout | RolloutFailure
        try:
            result = run_rollout(job.setup, job.planner, job.renderer, job.on_frame, timings)
        except Exception as error:
            result = failure(job.setup, job.planner.name, error)
        results.append(result)
        if on_done is not None:
            on_done(job, result, timings)
    return results


def failure(setup: RolloutSetup, planner: str, error: Exception) -> RolloutFailure:
    """The report row of a rollout that raised `error`."""
    return RolloutFailure(
        name=setup.name,
        arm=setup.arm,
        track_id=setup.track_id,
        motion=setup.motion.name,
        setting=setup.motion.setting,
        planner=planner,
        **error_fields(error),
    )


def error_fields(error: BaseException) -> dict[str, str]:
    """The members `error`, `reason` and `traceback` of a `RolloutFailure`."""
    try:
        reason = str(error)
    except Exception as another:  # an exception class of a planner may be faulty itself
        reason = f"its message cannot be read ({type(another).__name__})"
    lines = "".join(traceback.format_exception(error))
    return {
        "error": type(error).__name__,
        "reason": _unicode(reason)[:_REASON_LIMIT],
        "traceback": _unicode(lines)[-TRACEBACK_LIMIT:],
    }


def _unicode(text: str) -> str:
    """Lone surrogates, which no table and no page can hold, escaped."""
    return text.encode("utf-8", "backslashreplace").decode()
