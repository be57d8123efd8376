"""The cells of a generation study, by a crew of workers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from recast.crews import alone, crew_of
from recast.evaluation.generation_placement import Placement
from recast.pipeline.generation_maker import CellJob, CellMaker, Measures

Told = Callable[[CellJob, dict[str, float]], None]
"""Called with every job that is done and the seconds it took."""


def make_cells(
    jobs: Sequence[CellJob],
    measures: Measures,
    seed: int,
    placement: Placement,
    workers: int,
    told: Told,
) -> None:
    """Make and write all cells; the files are the same bytes for any number of workers.

    Args:
        jobs: those of one model in a row, since every process keeps just one loaded.
        measures, seed, placement: see `CellMaker`.
        workers: processes; with one, all is done in this process.
        told: of each job, in the order in which they end.

    Raises:
        InputError: see `CellMaker`, or a process was killed. Finished cells stay.
    """
    crew = alone if len(jobs) < 2 else crew_of(min(workers, len(jobs)))
    left, plan = iter(jobs), (measures, seed, placement)
    for job, took in crew(_start_maker, plan, lambda: next(left, None), "finished vehicles"):
        told(job, took)


def _start_maker(
    number: int, measures: Measures, seed: int, placement: Placement
) -> Callable[[CellJob], dict[str, float]]:
    del number
    return CellMaker(measures, seed, placement)
