"""`recast run`: the whole job."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Run:
    """Everything from a log to a report: scene, actor, closed-loop rollouts, metrics.

    Scenes, actors and rollouts are kept in a store and found again, by this run and by others.
    """

    log: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="PATH")]]
    """Log folder, or its address in object storage (s3://...)."""
    track: str
    """Track to replace and control; `recast log info LOG` lists them."""
    out: Path
    """Run folder."""
    motion: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """What the actor does: cut-in, oncoming, stationary, advancing (both settings), one setting
    such as cut-in-a, or a scenario file (.yaml). Give it several times for several. Default: cut-in
    and stationary."""
    arm: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """What is compared: native (the vehicle as reconstructed), replaced (a generated one), oracle
    (the truth, of a synthetic log), a generator such as recast-mini, a street such as omnire or a
    scene's folder, both such as omnire+template, or a file of arms (see docs/runs.md). Give it
    several times. Default: native and replaced."""
    config: Path | None = None
    """Configuration file (JSON, see docs/runs.md). The options override it."""
    planner: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Planner under test: a name, a folder, or package.module:attribute. Give it several times for
    several. Default: idm-follower."""
    planner_device: str | None = None
    """Where the planner computes: auto, cpu, cuda or cuda:1. Default: auto, a GPU where there is
    one."""
    generator: str | None = None
    """What makes the actor: auto (the better one of template and recast-mini for
    this vehicle), recast-mini (the image-to-3D model of the package), template, an
    installed generator's name, a model folder, the path of a PLY, GLB or OBJ, or library:FOLDER
    (the best of the files and actors in it)."""
    axes: str | None = None
    """Axes of vehicle files or a model folder: which one points up, such as z-up, y-up or
    minus-y-up (a splat viewer's), or forward and up, such as x,z (write --axes=-y,z with a minus).
    auto tells a file's from its shape, and takes models for z-up. Default: auto."""
    refine: bool | None = None
    """Whether the actor follows all images of the log, which takes a minute. Default: yes."""
    segmenter: str | None = None
    """What cuts the actor's picture out: box-lidar, an installed segmenter's name, or a folder that
    holds grounding-dino and sam (see docs/actors.md). Default: box-lidar."""
    views: int | None = None
    """Number of views of the target to make the actor from, at most: the best one and others that
    show other sides. Default: 1."""
    scene: Path | None = None
    """Folder of a trained or imported scene, instead of training one."""
    store: str | None = None
    """Folder or address (s3://...) of the artefacts that runs share. Default: store, beside the run
    folder."""
    preset: Literal["streetgs", "omnire"] | None = None
    """Reconstruct by the method of Street Gaussians or of OmniRe; recast's own where none is named
    (see docs/scenes.md)."""
    scene_config: Path | None = None
    """Scene configuration file (JSON, see docs/scenes.md): goes before the preset, and the options
    below before both."""
    cameras: tuple[str, ...] | None = None
    """Cameras to reconstruct and render; all of the log where none is named."""
    scale: float | None = None
    """Image scale: 0.5 works at half the recorded width and height."""
    iterations: int | None = None
    """Training steps of the scene."""
    steps: int | None = None
    """Steps of 0.1 s a rollout; cut where log or road end. Default: 160."""
    seed: int | None = None
    """Seed of everything random."""
    threads: int | None = None
    """CPU threads, 0 for all."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.options import resolve_config
        from recast.pipeline.run import run

        config = resolve_config(
            track=self.track,
            motions=self.motion,
            config_file=self.config,
            scene_config_file=self.scene_config,
            run_options={
                "arms": self.arm or None,
                "scene_folder": None if self.scene is None else str(self.scene.absolute()),
                "preset": self.preset,
                "planners": self.planner or None,
                "planner_device": self.planner_device,
                "generator": self.generator,
                "axes": self.axes,
                "refine": self.refine,
                "segmenter": self.segmenter,
                "views": self.views,
                "steps": self.steps,
                "seed": self.seed,
                "threads": self.threads,
            },
            scene_options={
                "cameras": self.cameras,
                "scale": self.scale,
                "iterations": self.iterations,
                "seed": self.seed,
                "threads": self.threads,
            },
        )
        run(self.log, self.out, config, Console(), self.store)
