"""A street's own actor and a generated one against the oracle, in views that the log lacks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console

from recast.actors import Actor, insert
from recast.evaluation import evaluate_oracle_views
from recast.pipeline.display import FrameProgress, truth_table
from recast.pipeline.layout import VIEWS_FOLDER
from recast.pipeline.source_log import SourceLog
from recast.scene import SceneConfig, StreetScene
from recast.simulation import camera_mounts
from recast.synthetic import Oracle
from recast.synthetic.rig import exposure


def compare_with_truth(
    scene: StreetScene,
    actor: Actor,
    source: SourceLog,
    config: SceneConfig,
    seed: int,
    out: Path,
    console: Console,
) -> None:
    """Write views and scores into a folder, see `evaluate_oracle_views`, and print the table.

    Args:
        scene: with its own model of the track.
        actor: to be inserted in its place.
        source: a synthetic log.
        config: of the street: cameras and image scale.

    Raises:
        InputError: see `evaluate_oracle_views`; or the log is not synthetic.
    """
    mounts = camera_mounts(source.log, config.cameras or None, config.scale)
    world = source.world
    with FrameProgress(console, 1, "views") as progress:
        views = evaluate_oracle_views(
            source.log,
            scene,
            insert(scene, actor),
            Oracle(world),
            actor.track_id,
            mounts,
            out / VIEWS_FOLDER,
            rng=np.random.default_rng(seed),
            exposures={name: exposure(world.seed, name) for name in mounts},
            shares=actor.shares,
            progress=progress.reach,
        )
    console.print(truth_table(views))
