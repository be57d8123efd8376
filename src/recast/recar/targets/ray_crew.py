"""Targets made on a Ray cluster."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

from recast.errors import InputError
from recast.recar.targets.crews import Crew
from recast.recar.targets.maker import Job, Outcome, TargetMaker
from recast.recar.targets.model_source import ModelSource
from recast.recar.targets.settings import TargetSettings


def on_ray(address: str, workers: int) -> Crew:
    """Make targets on a Ray cluster, with a model in each of `workers` actors.

    Pictures travel with the jobs and targets come back, so that only this process needs the set
    and the cache; the model folder must lie under the same path on every machine. An actor asks
    for one core, and for one GPU where the cluster has any. A connection that this process has
    already is used, and stays.

    Args:
        address: of the cluster, such as "auto" or "ray://head:10001"; "local" starts one here.
        workers: actors.

    Raises:
        InputError: Ray is not installed, or there is no cluster.
    """
    try:
        ray: Any = import_module("ray")
    except ImportError:
        raise InputError(
            "--ray", address, "needs Ray, which is not installed",
            "pip install 'recast[distributed]'",
        ) from None  # fmt: skip

    def crew(
        source: ModelSource, settings: TargetSettings, jobs: Iterable[Job]
    ) -> Iterator[Outcome]:
        ours = not ray.is_initialized()
        try:
            if ours:
                ray.init(address=address, log_to_driver=False)
        except (ConnectionError, RuntimeError, ValueError) as error:
            reason = str(error).strip().splitlines()[0]
            raise InputError(
                "--ray", address, f"no cluster answers ({reason[:80]})", "start one: ray start"
            ) from None
        try:
            # workers of the cluster import recast, and find the model, by themselves
            gpus = 1 if ray.cluster_resources().get("GPU", 0) and source.device != "cpu" else 0
            remote: Any = ray.remote(num_cpus=1, num_gpus=gpus)(_RemoteMaker)
            plan = _absolute(source, settings)
            yield from _outcomes(ray, [remote.remote(*plan) for _ in range(workers)], jobs)
        except ray.exceptions.RayTaskError as error:
            if isinstance(error.cause, InputError):
                raise error.cause from None
            raise
        except ray.exceptions.RayActorError as error:
            raise InputError(
                "--ray", address, f"a worker is gone ({str(error).splitlines()[0][:80]})",
                "run again; finished targets stay",
            ) from None  # fmt: skip
        finally:
            if ours:
                ray.shutdown()

    return crew


def _absolute(source: ModelSource, settings: TargetSettings) -> tuple[ModelSource, TargetSettings]:
    """The same with paths that do not depend on the working folder, which is another there."""

    def path(given: Path | None) -> Path | None:
        return None if given is None else given.absolute()

    judge = settings.filter
    files = {"predictor": path(judge.predictor), "clip": path(judge.clip)}
    return (
        replace(source, folder=source.folder.absolute(), image_encoder=path(source.image_encoder)),
        settings.model_copy(update={"filter": judge.model_copy(update=files)}),
    )


class _RemoteMaker:
    """Lives on a worker of the cluster."""

    def __init__(self, source: ModelSource, settings: TargetSettings) -> None:
        import torch

        from recast.splats import set_threads

        torch.set_num_threads(1)
        set_threads(1)
        self._plan = (source, settings)
        self._maker: TargetMaker | None = None

    def make(self, job: Job) -> Outcome:
        if self._maker is None:  # not when made, whose errors come back as a lost actor
            self._maker = TargetMaker.load(*self._plan)
        return self._maker.make(job)


def _outcomes(ray: Any, makers: list[Any], jobs: Iterable[Job]) -> Iterator[Outcome]:
    """One job at a time for each maker, another as soon as it is done."""
    left, busy = iter(jobs), {}
    for maker, job in zip(makers, left, strict=False):
        busy[maker.make.remote(job)] = maker
    while busy:
        done, _ = ray.wait(list(busy), num_returns=1)
        maker = busy.pop(done[0])
        outcome: Outcome = ray.get(done[0])
        for job in islice(left, 1):
            busy[maker.make.remote(job)] = maker
        yield outcome
