"""`recast run`: from a log to a report, in steps that resume."""

from __future__ import annotations

from pathlib import Path

import torch
from rich.console import Console

from recast import storage
from recast.cores import usable_cores
from recast.errors import InputError
from recast.logs import read_log
from recast.pipeline.actor import ActorMakers
from recast.pipeline.config import RunConfig
from recast.pipeline.fingerprint import folder_hash
from recast.pipeline.job import Job
from recast.pipeline.methods import Renderers
from recast.pipeline.planner import announce_planner, run_mounts
from recast.pipeline.run_folder import RunFolder
from recast.pipeline.sources import Sources
from recast.planning import make_planner
from recast.splats import set_threads
from recast.synthetic import world_of
from recast.synthetic.rendering import require_embree


def run(log_path: str | Path, out: str | Path, config: RunConfig, console: Console) -> Path:
    """Do the whole job and return the report's `index.html`.

    Args:
        log_path: log folder.
        out: run folder; one that holds this run already is resumed.
        console: shows steps, progress and time left.

    Raises:
        InputError: bad log, track, planner, generator or segmenter, a camera that the planner wants
            and the log lacks, a folder that holds another run, or another process at work there.
    """
    log_path, out = Path(log_path), Path(out)
    log = read_log(log_path)
    # What cannot work is refused before anything is written and before minutes of training.
    if config.track not in log.tracks:
        raise InputError(
            log_path, f"track {config.track}", "is not in the log",
            f"choose one of {', '.join(log.tracks)}",
        )  # fmt: skip
    world = None
    if "oracle" in config.methods:
        require_embree()
        world = world_of(log)
    sources = Sources.of(config)
    planner = make_planner(config.planner, config.planner_device)
    mounts = run_mounts(log, planner, config)
    announce_planner(planner, mounts, console)
    makers = ActorMakers.named(config.generator, config.segmenter, config.axes)
    threads = config.threads or usable_cores()
    torch.set_num_threads(threads)
    set_threads(threads)
    folder = RunFolder.create_or_resume(
        out, config.resolved(), str(log_path), folder_hash(log_path)
    )
    with storage.alone_in(folder.path), Renderers(folder.path, world, mounts) as renderers:
        job = Job(log, world, folder, config, sources, planner, renderers, console, makers)
        del makers  # the job lets go of the networks when the actor is made
        return job.finish()
