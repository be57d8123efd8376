"""What motions say, checked: they may be the user's own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.logs.checks import WORLD_REACH
from recast.simulation.actor_motion import ActorMotion, ScriptMotion
from recast.simulation.rollout import PATH_COLUMNS
from recast.simulation.situation import StartSituation

Array = NDArray[np.float64]

_SCRIPT_MEND = "see docs/scenarios.md for what a motion's script is"
_STEP_MEND = "return x, y, heading, speed >= 0, see docs/scenarios.md"


def checked_script(
    motion: ScriptMotion, situation: StartSituation, steps: int, dt: float, where: str
) -> Array:
    """A motion's states (steps + 1, 4).

    Raises:
        InputError: the script is not made of states; names the motion, the step and the value.
    """
    actor = np.asarray(motion.script(situation, steps, dt))
    expected, problem = (steps + 1, len(PATH_COLUMNS)), None
    if actor.shape != expected or actor.dtype.kind not in "iuf":
        problem = f"its script is {actor.dtype} {actor.shape}, not numbers {expected}"
    elif not (np.abs(actor) <= WORLD_REACH).all():  # also NaN
        step = int(np.argmin((np.abs(actor) <= WORLD_REACH).all(axis=1)))
        problem = f"its state {step} is {actor[step].tolist()}"
    elif (actor[:, 3] < 0).any():
        problem = f"its speed is negative in state {int(np.argmax(actor[:, 3] < 0))}"
    if problem is not None:
        raise InputError(where, f"motion {motion.name}", problem, _SCRIPT_MEND)
    return actor.astype(np.float64)


def checked_state(motion: ActorMotion, value: object, step: int, where: str) -> Array:
    """A state (4,) that a motion's `start` or `step` returned.

    Args:
        step: of the state, 0 at the start.

    Raises:
        InputError: it is no state; names the motion, the step and the value.
    """
    try:
        state = np.asarray(value)
    except ValueError:  # nested lists of different lengths
        state = np.asarray(None)
    fault = None
    if state.dtype.kind not in "iuf" or state.shape != (len(PATH_COLUMNS),):
        shown = f"{state.dtype} {state.shape}" if isinstance(value, np.ndarray) else f"{value!r}"
        fault = f"is {shown[:80]}, not numbers ({len(PATH_COLUMNS)},)"
    elif not (np.abs(state) <= WORLD_REACH).all():  # also NaN
        fault = f"is {state.tolist()}"
    elif state[3] < 0:
        fault = f"has the negative speed {state[3]:g}"
    if fault is not None:
        raise InputError(where, f"motion {motion.name}", f"its state {step} {fault}", _STEP_MEND)
    return state.astype(np.float64)
