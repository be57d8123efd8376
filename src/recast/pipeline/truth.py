"""Native and replaced actor against the oracle, in views that the log does not have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console

from recast.actors import load_actor
from recast.evaluation import evaluate_oracle_views
from recast.logs import DrivingLog
from recast.pipeline.config import RunConfig
from recast.pipeline.display import FrameProgress, truth_table
from recast.pipeline.layout import TRUTH_FOLDER, final_actor
from recast.pipeline.methods import method_scene
from recast.simulation import camera_mounts
from recast.synthetic import Oracle, World
from recast.synthetic.rig import exposure


def compare_with_truth(
    run: Path, log: DrivingLog, world: World, config: RunConfig, console: Console
) -> None:
    """Write the folder `truth` of a run and print the table.

    Args:
        run: run folder with scene and actor.
        world: what `log` was made from.

    Raises:
        InputError: see `recast.evaluation.evaluate_oracle_views`.
    """
    mounts = camera_mounts(log, config.scene.cameras or None, config.scene.scale)
    with FrameProgress(console, 1, "views") as progress:
        views = evaluate_oracle_views(
            log,
            method_scene("native", run),
            method_scene("replaced", run),
            Oracle(world),
            config.track,
            mounts,
            run / TRUTH_FOLDER,
            rng=np.random.default_rng(config.seed),
            exposures={name: exposure(world.seed, name) for name in mounts},
            shares=load_actor(final_actor(run)).shares,
            progress=progress.reach,
        )
    console.print(truth_table(views))
