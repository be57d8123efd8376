"""What a crew is, and the smallest: this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Protocol, TypeVar

from recast.crews.child_process import one_thread

Job = TypeVar("Job")
Outcome = TypeVar("Outcome")

Start = Callable[..., Callable[[Job], Outcome]]
"""Called once by each worker, with its number and the arguments: makes what does the jobs.

A function of a module, so that other processes find it.
"""


class Crew(Protocol):
    """Does jobs; what comes of each may not depend on which worker did it or what it did before."""

    def __call__(
        self,
        start: Start[Job, Outcome],
        arguments: tuple[Any, ...],
        take: Callable[[], Job | None],
        finished: str,
    ) -> Iterator[tuple[Job, Outcome]]:
        """Jobs with their outcomes, in the order in which they end.

        Args:
            start: see `Start`.
            arguments: for it, after the worker's number, which counts from 0.
            take: gives the next job, or None where there is none now. It is asked again after each
                outcome, so that outcomes may bring new jobs; it ends when nothing is at work.
            finished: what stays of an earlier try, such as "finished vehicles".

        Raises:
            InputError: a worker was killed.
            Exception: whatever `start` or a job raises; no other job is begun then.
        """


def alone(
    start: Start[Job, Outcome],
    arguments: tuple[Any, ...],
    take: Callable[[], Job | None],
    finished: str,
) -> Iterator[tuple[Job, Outcome]]:
    """Do all jobs in this process, on one thread as the workers do."""
    del finished
    with one_thread():
        work: Callable[[Job], Outcome] | None = None
        while (job := take()) is not None:
            if work is None:
                work = start(0, *arguments)
            yield job, work(job)
