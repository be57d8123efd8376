"""Calling a planner: in this process, or with a time limit in one of its own."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing import util
from multiprocessing.connection import Connection
from multiprocessing.pool import ExceptionWithTraceback  # type: ignore[attr-defined]
from multiprocessing.reduction import ForkingPickler
from time import perf_counter
from typing import Any, NoReturn

import numpy as np

from recast.core import diagnostics
from recast.core.diagnostics import Diagnostics
from recast.core.errors import InputError
from recast.core.foreign import ForeignCode, read_only, whole
from recast.core.workers import Closing, end_with_parent, use_threads
from recast.planning import (
    BasePlanner,
    Plan,
    Planner,
    PlannerAround,
    PlannerInput,
    PlanningContext,
)

_GRACE = 2.0
"""Seconds that a planner has to end its rollout before its process is killed."""
_LONGEST = 1e6
"""Seconds that can be waited for at once."""


class PlannerCalls:
    """Calls of a planner in this process; what it is given is read-only, its plans are copies."""

    def __init__(self, planner: Planner) -> None:
        self.planner = whole(planner, BasePlanner)
        self._guard = ForeignCode(f"planner {planner.name}")

    def reset(self, context: PlanningContext) -> None:
        """Begin a rollout; its seed is the seed of the planner's random numbers.

        Raises:
            Exception: whatever the planner raises, see `ForeignCode`; so too below.
        """
        self._guard = ForeignCode(f"planner {self.planner.name}", context.seed)
        with self._guard.call("reset"):
            self.planner.reset(read_only(context))

    def timed_plan(self, observation: PlannerInput, limit_s: float | None) -> tuple[Plan, float]:
        """A plan, and the seconds of wall-clock time that it took.

        Raises:
            ValueError: the answer is no plan, or took too long; names the planner and the step.
        """
        step, began = observation.step, perf_counter()
        with self._guard.call(f"plan at step {step}"):
            plan = self.planner.plan(read_only(observation))
        took = perf_counter() - began
        if limit_s is not None and took > limit_s:
            raise ValueError(
                f"planner {self.planner.name}: took {took:.3g} s for the plan at step {step}, "
                f"but the limit is {limit_s:g} s"
            )
        return checked_plan(plan, f"planner {self.planner.name}"), took

    def finish(self) -> None:
        """Call the planner's `finish_rollout`."""
        with self._guard.call("finish_rollout"):
            self.planner.finish_rollout()


def checked_plan(plan: object, who: str, verb: str = "returned") -> Plan:
    """A plan that can be executed, with a copy of the waypoints.

    Raises:
        ValueError: it is none; one line that begins with `who` and `verb`.
    """
    if not isinstance(plan, Plan):
        raise ValueError(f"{who}: {verb} {type(plan).__name__}, not a Plan")
    try:
        plan.validate()
    except ValueError as error:
        raise ValueError(f"{who}: {error}") from None
    return replace(plan, waypoints=np.array(plan.waypoints, np.float64))


class PlannerProcess(Closing, PlannerAround):
    """A planner in a process of its own, which is ended if a plan takes too long.

    It is itself a planner, whose other members are those of the planner in this process. The other
    process starts with the next rollout, and again after one that was ended. Close it.

    Args:
        planner: the planner.
        make: function that can be pickled and makes the planner there; None if the planner itself
            can be pickled.
    """

    def __init__(self, planner: Planner, make: Callable[[], Planner] | None = None) -> None:
        super().__init__(planner)
        self._make = make
        self._records: dict[str, Any] = {}
        self._connection: Connection | None = None
        self._end: Callable[[], object] = lambda: None

    def __deepcopy__(self, memo: dict[int, Any]) -> NoReturn:
        problem = "runs in a process of its own, whose state cannot be copied"
        raise InputError(f"planner {self.name}", "copy", problem, "remove the time limit")

    @property
    def record_fields(self) -> Mapping[str, str | float]:
        """What the planner said in its process after the last rollout; before one, as here."""
        return self._records or super().record_fields

    def finish_rollout(self) -> None:
        """As `finish`."""
        self.finish()

    def reset(self, context: PlanningContext) -> None:
        """Begin a rollout.

        Raises:
            InputError: the planner cannot be sent to another process.
            ValueError: its process ended; so too below.
            Exception: whatever the planner raises; so too below.
        """
        if self._connection is None:
            self._start()
        self._ask("reset", context)

    def plan(self, observation: PlannerInput) -> Plan:
        """A plan, whatever time it takes."""
        return self.timed_plan(observation, None)[0]

    def timed_plan(self, observation: PlannerInput, limit_s: float | None) -> tuple[Plan, float]:
        """As `PlannerCalls.timed_plan`; a planner that does not answer in time is ended."""
        answer: tuple[Plan, float] = self._ask("plan", observation, limit_s)
        return answer

    def finish(self) -> None:
        """As `PlannerCalls.finish`; nothing if the planner was ended."""
        if self._connection is not None:
            self._records = self._ask("finish")

    def close(self) -> None:
        """End the process."""
        self._connection = None
        self._end()

    def _start(self) -> None:
        try:
            made = bytes(ForkingPickler.dumps(self.part if self._make is None else self._make))
        except Exception as error:  # of pickle, and of the planner's own methods for it
            raise self._unsendable(error) from error
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        torch = sys.modules.get("torch")
        threads = torch.get_num_threads() if torch else None
        process = context.Process(
            target=_serve,
            args=(there, made, self._make is None, threads, diagnostics.current()),
            name=f"planner {self.name}",
        )
        process.start()
        there.close()
        self._connection = here
        # Not a daemon, which could start no processes; ended before this process waits for it.
        self._end = util.Finalize(self, _end, (process, here), exitpriority=10)

        def code() -> int | None:
            process.join(_GRACE)
            return process.exitcode

        self._code = code
        try:
            self._ask("start")
        except InputError:
            raise
        except Exception as error:
            raise self._unsendable(error) from error

    def _unsendable(self, error: Exception) -> InputError:
        problem = f"cannot be moved to a process of its own ({type(error).__name__}: {error})"
        mend = "give the planner as package.module:attribute, or remove the time limit"
        return InputError(f"planner {self.name}", "time limit", problem, mend)

    def _ask(self, method: str, given: Any = None, limit_s: float | None = None) -> Any:
        connection = self._connection
        assert connection is not None
        try:
            connection.send((method, given, limit_s))
            if limit_s is not None and not connection.poll(min(limit_s, _LONGEST)):
                self.close()
                raise ValueError(
                    f"planner {self.name}: gave no plan at step {given.step} within the "
                    f"limit of {limit_s:g} s"
                )
            error, answer = connection.recv()
        except (EOFError, OSError):
            code = self._code()
            self.close()
            message = f"planner {self.name}: its process ended in {method} with exit code {code}"
            raise ValueError(message) from None
        except BaseException:  # an interrupt: the answer is not waited for
            self.close()
            raise
        if error is not None:
            raise error
        return answer


@contextmanager
def calling(planner: Planner, limit_s: float | None) -> Iterator[PlannerCalls | PlannerProcess]:
    """The calls of a planner for one rollout; a process that is made for it ends with it."""
    if isinstance(planner, PlannerProcess):
        yield planner
    elif limit_s is None:
        yield PlannerCalls(planner)
    else:
        with PlannerProcess(planner) as process:
            yield process


def _end(process: multiprocessing.process.BaseProcess, connection: Connection) -> None:
    connection.close()
    process.terminate()
    process.join(_GRACE)
    process.kill()
    process.join()


def _serve(
    connection: Connection, made: bytes, ready: bool, threads: int | None, records: Diagnostics
) -> None:
    """Answer calls until the other side is gone, or asks by a signal to end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    end_with_parent()
    diagnostics.begin(records)
    calls: PlannerCalls | None = None

    def answer(method: str, given: Any, limit_s: float | None) -> Any:
        nonlocal calls
        if method == "start":
            part = pickle.loads(made)
            calls = PlannerCalls(part if ready else part())
            return None
        assert calls is not None
        if method == "plan":
            return calls.timed_plan(given, limit_s)
        if method == "reset":
            return calls.reset(given)
        calls.finish()
        return dict(calls.planner.record_fields)

    if threads is not None:
        import torch  # noqa: F401  # random numbers and threads are those of the other process

        use_threads(threads)
    with suppress(EOFError, OSError, SystemExit):
        while True:
            asked = connection.recv()
            try:
                reply = None, answer(*asked)
                data = ForkingPickler.dumps(reply)
            except Exception as error:
                data = ForkingPickler.dumps((_sendable(error), None))
            connection.send_bytes(data)
    if calls is not None:
        with suppress(BaseException):
            calls.finish()


def _sendable(error: Exception) -> Exception:
    """An error with its traceback, or, if it cannot be pickled, one of the same words."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        words = "".join(traceback.format_exception_only(error)).strip()
        error = RuntimeError(words).with_traceback(error.__traceback__)
    sent: Exception = ExceptionWithTraceback(error, error.__traceback__)
    return sent
