"""`recast bench`: whole experiments as one command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from recast.pipeline.layout import Method


@dataclass(frozen=True)
class Bench:
    """The paper's closed-loop protocol: scenes x motions x settings x methods, and its table.

    Finished rollouts are kept, so the same command resumes where it was stopped or killed.
    """

    experiment: tyro.conf.Positional[Literal["closed-loop"]]
    """Which: closed-loop is the only one there is."""
    scenes: tuple[str, ...]
    """Synthetic scenes, each with :SEED if you like; the word synthetic for all nine; or log
    folders with the track to control, LOG:TRACK."""
    out: Path
    """Folder of the grid; new, or one of the same options, which is finished."""
    methods: tuple[Method, ...] | None = None
    """What renders the street: native (the vehicle as reconstructed), replaced (the generated one),
    oracle (the truth, of synthetic logs). The others are compared with the first. Default: native
    and replaced."""
    planner: str | None = None
    """Planner under test: a name, a folder, or package.module:attribute. Default: idm-follower."""
    planner_device: str | None = None
    """Where the planner computes: auto, cpu, cuda or cuda:1. Default: auto, a GPU where there is
    one."""
    motions: tuple[str, ...] = ()
    """What the actor does: motions (all settings), scenarios such as cut-in-a, or scenario files.
    Default: cut-in, oncoming and stationary."""
    track: str | None = None
    """Track to control in log folders that are named without one."""
    workers: int = 1
    """Processes, one thread each; the results are the same for any number."""
    ray: str | None = None
    """Address of a Ray cluster (auto, ray://HOST:10001), or local. Needs the extra distributed."""
    config: Path | None = None
    """Configuration file (JSON, see docs/runs.md), or the bench.json of another grid. The options
    override it; scenes and motions are those of the options."""
    quick: bool = False
    """A small grid to try things: 8 s drives, one camera of 192x128, 300 training steps, rollouts
    of 40 steps. Other options override it."""
    films: bool = False
    """Render and film every step, not only what the planner sees."""
    plan_timeout: float | None = None
    """Seconds that one plan may take; a rollout with a slower one fails."""
    retry_failures: bool = False
    """Run rollouts again that failed in an earlier try."""
    seconds: float | None = None
    """Of synthetic drives, up to 20. Default: 20."""
    width: int | None = None
    """Of synthetic images, pixels. Default: 480."""
    height: int | None = None
    """Of synthetic images, pixels. Default: 320."""
    generator: str | None = None
    """What makes the actor, as for recast run."""
    refine: bool | None = None
    """Whether the actor follows all images of the log, which takes a minute. Default: yes."""
    segmenter: str | None = None
    """What cuts the actor's picture out, as for recast run."""
    scene_config: Path | None = None
    """Scene configuration file (JSON, see docs/scenes.md)."""
    cameras: tuple[str, ...] | None = None
    """Cameras to record, reconstruct and render; all where none is named."""
    scale: float | None = None
    """Image scale: 0.5 works at half the recorded width and height. Default: 1."""
    iterations: int | None = None
    """Training steps of every scene."""
    steps: int | None = None
    """Steps of 0.1 s a rollout; cut where log or road end. Default: 160."""
    seed: int | None = None
    """Seed of everything random, and of synthetic scenes without one of their own."""
    samples: int = 200_000
    """Bootstrap samples of the intervals."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.bench import resolve_bench, run_closed_loop

        settings = resolve_bench(
            words=self.scenes,
            track=self.track,
            motions=self.motions,
            quick=self.quick,
            config_file=self.config,
            scene_config_file=self.scene_config,
            samples=self.samples,
            drive_options={"seconds": self.seconds, "width": self.width, "height": self.height},
            run_options={
                "methods": self.methods,
                "planner": self.planner,
                "planner_device": self.planner_device,
                "generator": self.generator,
                "refine": self.refine,
                "segmenter": self.segmenter,
                "steps": self.steps,
                "seed": self.seed,
                "plan_limit_s": self.plan_timeout,
                "films": self.films,
            },
            scene_options={
                "cameras": self.cameras,
                "scale": self.scale,
                "iterations": self.iterations,
                "seed": self.seed,
            },
        )
        run_closed_loop(
            settings, self.out, Console(), workers=self.workers, ray=self.ray,
            retry_failures=self.retry_failures,
        )  # fmt: skip
