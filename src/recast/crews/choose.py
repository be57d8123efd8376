"""The crew that options name."""

from __future__ import annotations

from recast.crews.crew import Crew, alone
from recast.crews.processes import in_processes
from recast.crews.ray_cluster import on_ray
from recast.errors import InputError


def crew_of(workers: int, ray: str | None = None, gpu: bool = False) -> Crew:
    """The crew that the options --workers and --ray name.

    Args:
        workers: processes, or actors of the cluster.
        ray: address of a Ray cluster, see `on_ray`; None for none.
        gpu: whether each worker of a cluster wants a GPU, if there is any.

    Raises:
        InputError: less than one worker, or Ray is not installed.
    """
    if workers < 1:
        raise InputError("--workers", "value", f"is {workers}", "give 1 or more")
    if ray is not None:
        return on_ray(ray, workers, gpu)
    return alone if workers == 1 else in_processes(workers)
