"""Vehicles prepared one after the other or by several processes, given back in their order."""

from __future__ import annotations

import multiprocessing
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor

from recast.crews.child_process import end_with_parent, worker_faults
from recast.errors import InputError
from recast.recar.ingest.background import BackgroundRemover
from recast.recar.ingest.prepare import Candidate, Prepared, prepare
from recast.recar.ingest.settings import IngestSettings


def prepare_all(
    candidates: Sequence[Candidate],
    settings: IngestSettings,
    remover: BackgroundRemover | None,
    workers: int,
) -> Iterator[tuple[Candidate, Prepared | InputError]]:
    """Every vehicle, or why it cannot be taken; not more than two for each worker in memory."""
    if workers == 1 or len(candidates) < 2:
        for candidate in candidates:
            yield candidate, _prepared(candidate, settings, remover)
        return
    # Spawned, not forked: the display of the parent draws from a thread, which may hold a lock.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _set_up_worker, (settings, remover)) as pool:
        running: deque[tuple[Candidate, Future[Prepared | InputError]]] = deque()
        with worker_faults(pool, "finished vehicles"):
            for candidate in candidates:
                running.append((candidate, pool.submit(_prepare_in_worker, candidate)))
                if len(running) >= 2 * workers:
                    first, future = running.popleft()
                    yield first, future.result()
            while running:
                first, future = running.popleft()
                yield first, future.result()


def _prepared(
    candidate: Candidate, settings: IngestSettings, remover: BackgroundRemover | None
) -> Prepared | InputError:
    try:
        return prepare(candidate, settings, remover)
    except InputError as error:
        return error


_shared: tuple[IngestSettings, BackgroundRemover | None]


def _set_up_worker(settings: IngestSettings, remover: BackgroundRemover | None) -> None:
    global _shared
    _shared = (settings, remover)
    import cv2

    cv2.setNumThreads(1)
    end_with_parent()


def _prepare_in_worker(candidate: Candidate) -> Prepared | InputError:
    return _prepared(candidate, *_shared)
