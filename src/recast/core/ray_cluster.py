"""Workers on a Ray cluster, and the pool that options name."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from recast.core import diagnostics
from recast.core.diagnostics import Diagnostics
from recast.core.errors import InputError, require_range
from recast.core.workers import Job, Outcome, Start, WorkerPool, in_processes, in_this_process


def on_ray(address: str, workers: int, gpu: bool = False) -> WorkerPool:
    """A pool of this many actors of a Ray cluster.

    Jobs travel there and outcomes come back; the machines share no folder that jobs do not name.
    An actor asks for one core, and for one GPU where it is to have one and the cluster has any. A
    connection that this process has already is used, and stays.

    Args:
        address: address of the cluster, such as "auto" or "ray://head:10001"; "local" starts one
            here.

    Raises:
        InputError: Ray is not installed; when the pool begins, that there is no cluster.
    """
    try:
        ray: Any = import_module("ray")
    except ImportError:
        raise InputError(
            "`ray`",
            address,
            "needs Ray, which is not installed",
            "pip install 'recast-sim[distributed]'",
        ) from None

    def pool(
        start: Start[Job, Outcome],
        arguments: tuple[Any, ...],
        take: Callable[[], Job | None],
        finished: str,
    ) -> Iterator[tuple[Job, Outcome]]:
        ours = not ray.is_initialized()
        try:
            if ours:
                ray.init(address=address, log_to_driver=False)
        except (ConnectionError, RuntimeError, ValueError) as error:
            reason = str(error).strip().splitlines()[0]
            raise InputError(
                "`ray`",
                address,
                f"no cluster answers ({reason[:80]})",
                "start one: ray start --head",
            ) from None
        try:
            # workers of the cluster import recast by themselves
            gpus = 1 if gpu and ray.cluster_resources().get("GPU", 0) else 0
            remote: Any = ray.remote(num_cpus=1, num_gpus=gpus)(_RemoteWorker)
            records = diagnostics.current()
            here = str(Path.cwd())
            actors = [
                remote.remote(start, number, arguments, records, here) for number in range(workers)
            ]
            yield from _outcomes(ray, actors, take)
        except ray.exceptions.RayTaskError as error:
            if isinstance(error.cause, InputError):
                raise error.cause from None
            raise
        except ray.exceptions.RayActorError as error:
            raise InputError(
                "`ray`",
                address,
                f"a worker has stopped ({str(error).splitlines()[-1][:80]})",
                f"run again; {finished} are kept",
            ) from None
        finally:
            if ours:
                ray.shutdown()

    return pool


def send_parcel(parcel: bytes) -> object:
    """Put bytes into the object store of the cluster; returns what `fetch_parcel` takes."""
    ray: Any = import_module("ray")
    return [ray.put(parcel)]  # in a list: Ray fetches bare arguments unasked


def fetch_parcel(ticket: object) -> bytes:
    """The bytes that were sent, from anywhere on the cluster."""
    ray: Any = import_module("ray")
    assert isinstance(ticket, list)
    return ray.get(ticket[0])


def node_folder() -> Path:
    """A folder that the workers of one machine of the cluster share."""
    ray: Any = import_module("ray")
    node = ray.get_runtime_context().get_node_id()
    return Path(tempfile.gettempdir()) / f"recast-{node[:16]}"


class _RemoteWorker:
    """Lives on a worker of the cluster."""

    def __init__(
        self,
        start: Start[Any, Any],
        number: int,
        arguments: tuple[Any, ...],
        records: Diagnostics,
        folder: str,
    ) -> None:
        import torch  # noqa: F401  (so that its threads are set)

        from recast.core.source_files import search_folder
        from recast.core.workers import use_threads

        search_folder(folder)  # users' code, on machines that have this folder
        self._records = records
        use_threads(1)
        self._start = lambda: start(number, *arguments)
        self._work: Callable[[Any], Any] | None = None

    def do(self, job: Any) -> Any:
        if self._work is None:  # not when made, whose errors come back as a lost actor
            diagnostics.begin(self._records)
            self._work = self._start()
        return self._work(job)


def _outcomes(
    ray: Any, actors: list[Any], take: Callable[[], Job | None]
) -> Iterator[tuple[Job, Any]]:
    """One job at a time for each actor, another as soon as it is done."""
    idle, busy = list(actors), {}
    while True:
        while idle and (job := take()) is not None:
            actor = idle.pop(0)
            busy[actor.do.remote(job)] = (actor, job)
        if not busy:
            return
        done, _ = ray.wait(list(busy), num_returns=1)
        actor, job = busy.pop(done[0])
        idle.append(actor)
        yield job, ray.get(done[0])


def worker_pool(workers: int, ray: str | None = None, gpu: bool = False) -> WorkerPool:
    """The pool that these settings name.

    Args:
        ray: address of a Ray cluster, see `on_ray`; None for none.
        gpu: whether each worker of a cluster wants a GPU, if there is any.

    Raises:
        InputError: less than one worker, or Ray is not installed.
    """
    require_range(1, workers=workers)
    if ray is not None:
        return on_ray(ray, workers, gpu)
    return in_this_process if workers == 1 else in_processes(workers)
