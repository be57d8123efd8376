"""Synthetic vehicle sets, made by several processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import islice
from pathlib import Path
from typing import Any

from recast.crews.child_process import end_with_parent, worker_faults
from recast.errors import InputError
from recast.recar.picture import Image
from recast.recar.record import SetRecord
from recast.recar.synthesis_plan import PlannedIdentity, SynthesisSettings, plan_identities
from recast.recar.vehicle_set import VehicleSet, read_set
from recast.recar.writer import begin_set, check_begin, finish_set, write_identity
from recast.storage import alone_in

Progress = Callable[[int, int], None]
"""Called with pictures done and all pictures."""


def synthesize_set(
    out: str | Path,
    vehicles: int,
    settings: SynthesisSettings | None = None,
    *,
    shapes: int = 0,
    meshes: Sequence[str | Path] = (),
    mesh_axes: str | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> VehicleSet:
    """Render a set of parametric vehicles, other shapes, and the user's own meshes.

    Finished identities stay when the run is killed, and the same call goes on from there; more
    vehicles, shapes or meshes make a finished set grow. Either way the files are the same bytes as
    those of one run, whatever the number of workers.

    Args:
        out: folder of the set; new, empty, or a set of the same settings.
        vehicles: number of parametric vehicles.
        settings: what all pictures share.
        shapes: number of other shapes: furniture, signs and the like.
        meshes: closed meshes of vehicles.
        mesh_axes: their forward and up axes, such as "-y,z"; None takes "z,y" for glTF and
            "x,z" for all others.
        workers: processes.
        progress: called as pictures are finished.

    Raises:
        InputError: impossible counts or sizes, a mesh that cannot be used, embreex not installed,
            or `out` holds something else, all before any work; or the disk is full.
    """
    settings = settings or SynthesisSettings()
    out = Path(out)
    settings.validate()
    if workers < 1:
        raise InputError("--workers", "value", f"is {workers}", "give 1 or more")
    plan = plan_identities(settings, vehicles, shapes, [Path(mesh) for mesh in meshes], mesh_axes)
    ids = [planned.id for planned in plan]
    record = settings.record(out.absolute().name, len(plan))
    check_begin(out, record, ids)
    _check_renderable(plan, settings)
    finished = begin_set(out, record, ids)
    left = [planned for planned in plan if planned.id not in finished]
    counter = _Counter(progress, len(plan) * record.views, len(finished) * record.views)
    with alone_in(out):
        if workers == 1 or len(left) < 2:
            for planned in left:
                _make(out, record, settings, planned, counter.advance)
        else:
            _make_in_processes(out, record, settings, left, min(workers, len(left)), counter)
        finish_set(out, record)
    return read_set(out)


class _Counter:
    def __init__(self, progress: Progress | None, total: int, done: int) -> None:
        self._progress, self._total, self._done = progress, total, done
        self.advance(0)

    def advance(self, pictures: int) -> None:
        self._done += pictures
        if self._progress is not None:
            self._progress(self._done, self._total)


def _check_renderable(plan: Sequence[PlannedIdentity], settings: SynthesisSettings) -> None:
    from recast.recar.render_identity import make_model
    from recast.synthetic.rendering import require_embree

    require_embree()
    for planned in plan:
        if planned.mesh is not None:
            make_model(planned, settings)


def _make(
    out: Path,
    record: SetRecord,
    settings: SynthesisSettings,
    planned: PlannedIdentity,
    advance: Callable[[int], Any],
) -> None:
    from recast.recar.render_identity import identity_record, make_model, render_views

    model = make_model(planned, settings)
    identity = identity_record(planned, model, record)

    def pictures() -> Iterator[Image]:
        for picture in render_views(model, identity, record):
            yield picture
            advance(1)

    write_identity(out, record, identity, pictures())


def _make_in_processes(
    out: Path,
    record: SetRecord,
    settings: SynthesisSettings,
    left: Sequence[PlannedIdentity],
    workers: int,
    counter: _Counter,
) -> None:
    # Spawned, not forked: the display of the parent draws from a thread, which may hold a lock.
    context = multiprocessing.get_context("spawn")
    finished_pictures = context.SimpleQueue()
    with ProcessPoolExecutor(workers, context, _set_up_worker, (finished_pictures,)) as pool:
        waiting, pending = iter(left), set[Future[None]]()
        with worker_faults(pool, "finished identities"):
            while True:
                # A few at a time: `wait` looks at every job that it is given.
                for planned in islice(waiting, 2 * workers - len(pending)):
                    pending.add(pool.submit(_make_in_worker, out, record, settings, planned))
                if not pending:
                    break
                done, pending = wait(pending, timeout=0.2, return_when=FIRST_COMPLETED)
                while not finished_pictures.empty():
                    counter.advance(finished_pictures.get())
                for future in done:
                    future.result()
        while not finished_pictures.empty():
            counter.advance(finished_pictures.get())


_advance: Callable[[int], Any]


def _set_up_worker(queue: Any) -> None:
    global _advance
    _advance = queue.put
    end_with_parent()


def _make_in_worker(
    out: Path, record: SetRecord, settings: SynthesisSettings, planned: PlannedIdentity
) -> None:
    _make(out, record, settings, planned, _advance)
