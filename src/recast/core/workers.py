"""Worker pools: this process, several of this machine with one thread each, or a Ray cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import connection
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

from recast.core import diagnostics
from recast.core.diagnostics import Diagnostics
from recast.core.errors import InputError, require_range
from recast.kernel import set_threads

Job = TypeVar("Job")
Outcome = TypeVar("Outcome")

Start = Callable[..., Callable[[Job], Outcome]]
"""Called once by each worker, with its number and the arguments: makes what does the jobs.

A function of a module, so that other processes find it.
"""
WAITING = 2
"""Jobs handed out for each process: one at work, one waiting."""
_THREAD_SETTINGS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_start: Callable[[], Callable[[Any], Any]]
_work: Callable[[Any], Any] | None = None


class WorkerPool(Protocol):
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
            arguments: arguments of `start` after the worker's number, which counts from 0.
            take: gives the next job, or None where there is none now. It is asked again after each
                outcome, so that outcomes may bring new jobs; it ends when nothing is at work.
            finished: what stays of an earlier try, such as "finished vehicles".

        Raises:
            InputError: a worker was killed.
            Exception: whatever `start` or a job raises; no other job is begun then.
        """


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


def in_this_process(
    start: Start[Job, Outcome],
    arguments: tuple[Any, ...],
    take: Callable[[], Job | None],
    finished: str,
) -> Iterator[tuple[Job, Outcome]]:
    """Do all jobs in this process, on one thread as the workers do."""
    del finished
    with _one_thread():
        work: Callable[[Job], Outcome] | None = None
        while (job := take()) is not None:
            if work is None:
                work = start(0, *arguments)
            yield job, work(job)


def in_processes(workers: int) -> WorkerPool:
    """A pool of this many processes."""

    def pool(
        start: Start[Job, Outcome],
        arguments: tuple[Any, ...],
        take: Callable[[], Job | None],
        finished: str,
    ) -> Iterator[tuple[Job, Outcome]]:
        # Spawned, not forked: CUDA and the threads of this process do not survive a fork, and the
        # display of the parent draws from a thread, which may hold a lock.
        context = multiprocessing.get_context("spawn")
        numbers: Any = context.SimpleQueue()
        for number in range(workers):
            numbers.put(number)
        initial = (start, arguments, numbers, diagnostics.current())
        with ProcessPoolExecutor(workers, context, _set_up, initial) as executor:
            pending: dict[Future[Outcome], Job] = {}
            with _cancelling(executor, finished):
                while True:
                    while len(pending) < WAITING * workers and (job := take()) is not None:
                        pending[submit(executor, _do, job)] = job
                    if not pending:
                        return
                    done, _ = wait(pending, return_when=FIRST_COMPLETED)
                    for future in done:
                        yield pending.pop(future), future.result()

    return pool


def _set_up(
    start: Start[Any, Any], arguments: tuple[Any, ...], numbers: Any, records: Diagnostics
) -> None:
    global _start
    begin_worker()
    diagnostics.begin(records)
    number = numbers.get()
    _start = lambda: start(number, *arguments)  # noqa: E731


def _do(job: Any) -> Any:
    global _work
    if _work is None:  # not in _set_up, whose errors nobody would hear of
        _work = _start()
    return _work(job)


class Closing:
    """A context manager that ends with `close`."""

    def close(self) -> None:
        """Give back what is held."""

    def __enter__(self) -> Self:
        """Nothing starts before it is needed."""
        return self

    def __exit__(self, *fault: object) -> None:
        """Close, whatever happened."""
        self.close()


def submit(
    executor: ProcessPoolExecutor, function: Callable[..., Outcome], *arguments: Any
) -> Future[Outcome]:
    """Hand out a call; a process that is started for it will compute on one thread."""
    with one_thread_in_children():
        return executor.submit(function, *arguments)


def begin_worker() -> None:
    """Make this process a worker: on one thread, and ended by its parent alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers itself
    end_with_parent()
    use_threads(1)


def use_threads(count: int) -> None:
    """Compute on `count` threads in this process, 0 for one on each usable core.

    Of torch this changes nothing where it is imported later: it reads the environment.
    """
    count = count or usable_cores()
    if torch := sys.modules.get("torch"):
        torch.set_num_threads(count)
    set_threads(count)


def end_with_parent() -> None:
    """End this process as soon as its parent is gone.

    The workers of a killed run would else wait for jobs for ever, or write into the folders of the
    next run.
    """
    threading.Thread(target=_wait, daemon=True).start()


@contextmanager
def _cancelling(executor: ProcessPoolExecutor, finished: str) -> Iterator[None]:
    """While jobs of an executor are waited for: cancel what is left when anything goes wrong.

    Args:
        executor: executor of the jobs.
        finished: what stays of an earlier try, such as "finished vehicles".

    Raises:
        InputError: a process ended, mostly for want of memory.
    """
    try:
        yield
    except BrokenProcessPool:
        raise InputError(
            "`workers`",
            "process",
            "ended, perhaps out of memory",
            f"run again with fewer workers; {finished} are kept",
        ) from None
    except BaseException:
        executor.shutdown(wait=False, cancel_futures=True)
        raise


@contextmanager
def _one_thread() -> Iterator[None]:
    """Compute on one thread, as workers do: more threads round sums otherwise."""
    torch = sys.modules.get("torch")
    before = torch.get_num_threads() if torch else usable_cores()
    if torch:
        torch.set_num_threads(1)
    try:
        with one_thread_in_children():  # read by torch too if it is imported meanwhile
            yield
    finally:
        if torch := sys.modules.get("torch"):
            torch.set_num_threads(before)


@contextmanager
def one_thread_in_children() -> Iterator[None]:
    """Libraries that are loaded meanwhile, here or in a new process, compute on one thread."""
    before = {name: os.environ.get(name) for name in _THREAD_SETTINGS}
    os.environ.update(dict.fromkeys(_THREAD_SETTINGS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def usable_cores() -> int:
    """Cores that this process may run on: fewer than the machine has if it was given a share."""
    if hasattr(os, "sched_getaffinity"):  # only on Linux
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _wait() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


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

        from recast.core.plugins import search_folder

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
