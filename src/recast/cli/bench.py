"""`recast bench`: whole experiments as one command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

if TYPE_CHECKING:
    from recast.pipeline.bench import BenchSettings


@dataclass(frozen=True, kw_only=True)
class _Grid:
    """Options of scenes, arms and motions."""

    scenes: tuple[str, ...]
    """Synthetic scenes, each with :SEED if you like; the word synthetic for all nine; or log
    folders with the track to control, LOG:TRACK."""
    out: Path
    """Folder of the grid; new, or one of the same options, which is finished."""
    arm: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """What is compared, as for recast run; also assets:DIR, vehicles in DIR/SCENE.ply, .glb or
    .obj. The others are compared with the first. Give it several times. Default: native and
    replaced."""
    track: str | None = None
    """Track to control in log folders that are named without one."""
    scene: Path | None = None
    """Folder of a trained or imported scene, instead of training one; for one log folder."""
    store: str | None = None
    """Folder or address (s3://...) of the artefacts that runs share. Default: store, beside the
    grid's folder."""
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

    def _settings(self, motions: Sequence[str], **options: Any) -> BenchSettings:
        from recast.pipeline.bench import resolve_bench

        return resolve_bench(
            words=self.scenes,
            track=self.track,
            motions=motions,
            quick=self.quick,
            config_file=self.config,
            scene_config_file=self.scene_config,
            samples=self.samples,
            drive_options={"seconds": self.seconds, "width": self.width, "height": self.height},
            run_options={
                "arms": self.arm or None,
                "scene_folder": None if self.scene is None else str(self.scene.absolute()),
                "generator": self.generator,
                "refine": self.refine,
                "segmenter": self.segmenter,
                "steps": self.steps,
                "seed": self.seed,
                **options,
            },
            scene_options={
                "cameras": self.cameras,
                "scale": self.scale,
                "iterations": self.iterations,
                "seed": self.seed,
            },
        )


@dataclass(frozen=True, kw_only=True)
class ClosedLoop(_Grid):
    """The paper's closed-loop protocol: scenes x motions x settings x arms x planners,
    and its table.

    Finished rollouts are kept, so the same command resumes where it was stopped or killed.
    """

    planner: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Planner under test: a name, a folder, or package.module:attribute. Give it several times for
    several. Default: idm-follower."""
    planner_device: str | None = None
    """Where the planner computes: auto, cpu, cuda or cuda:1. Default: auto, a GPU where there is
    one."""
    motions: tuple[str, ...] = ()
    """What the actor does: motions (all settings), scenarios such as cut-in-a, or scenario files.
    Default: cut-in, oncoming and stationary."""
    films: bool = False
    """Render and film every step, not only what the planner sees."""
    plan_timeout: float | None = None
    """Seconds that one plan may take; a rollout with a slower one fails."""
    retry_failures: bool = False
    """Run rollouts again that failed in an earlier try."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.bench import run_closed_loop

        settings = self._settings(
            self.motions,
            planners=self.planner or None,
            planner_device=self.planner_device,
            plan_limit_s=self.plan_timeout,
            films=self.films,
        )
        run_closed_loop(
            settings, self.out, Console(), workers=self.workers, ray=self.ray,
            retry_failures=self.retry_failures, store=self.store,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class SceneLevel(_Grid):
    """How real and how complete the images of arms look: Frechet distances, CLIP, VQA and LPIPS
    scores of whole frames and of vehicle crops.

    pdm-closed drives each scene and motion once, and every arm renders the same states. Scores
    whose weights are not given have no column.
    """

    motions: tuple[str, ...] = ()
    """What the actor does: motions (all settings), scenarios such as cut-in-a, or scenario files.
    Default: cut-in, oncoming, stationary and advancing."""
    inception: Path | None = None
    """Weights of the FID's Inception network, .pth or .safetensors; or inception (see recast
    weights)."""
    clip: Path | None = None
    """Folder of a CLIP model; or clip-vit-l14 (see recast weights)."""
    lpips_weights: Path | None = None
    """AlexNet or VGG-16 weights as torchvision saves them, for LPIPS; or alexnet or vgg16 (see
    recast weights)."""
    vqa: str | None = None
    """VQA scorer: clip-flant5-xl (see recast weights) or its folder, t2v_metrics:NAME, or
    package.module:attribute."""
    device: str = "cpu"
    """Where the networks compute: cpu, cuda or cuda:1."""
    every: int = 5
    """Steps between the images of a rollout that are looked at."""
    least_px: float = 32.0
    """Least length of the shorter side of the vehicle's box in the image, in pixels."""
    crop: Literal["boxed", "masked"] = "boxed"
    """Crops: boxed keeps the background around the vehicle, masked takes away what lies outside of
    the box's outline."""
    references: int = 16
    """Most logged crops of a scene that LPIPS and the CLIP image score compare with."""
    frechet_samples: int = 2000
    """Bootstrap samples of the intervals of Frechet distances."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.evaluation.scene_level.frames import FrameRule
        from recast.pipeline.bench.scene_level import (
            LEVEL_MOTIONS,
            LevelSettings,
            NetworkFiles,
            run_scene_level,
        )
        from recast.weights import located

        networks = NetworkFiles(
            located("--inception", self.inception), located("--clip", self.clip),
            located("--lpips-weights", self.lpips_weights), self.vqa, self.device,
        )  # fmt: skip
        settings = LevelSettings(
            grid=self._settings(self.motions or LEVEL_MOTIONS, films=False),
            rule=FrameRule(every=self.every, least_px=self.least_px),
            crop=self.crop,
            most_references=self.references,
            networks=networks,
            hashes=networks.hashes(),
            frechet_samples=self.frechet_samples,
        )
        run_scene_level(
            settings, self.out, Console(), workers=self.workers, ray=self.ray, store=self.store
        )


@dataclass(frozen=True)
class Bench:
    """Whole experiments of the paper over scenes, motions and arms."""

    command: (
        Annotated[ClosedLoop, tyro.conf.subcommand("closed-loop")]
        | Annotated[SceneLevel, tyro.conf.subcommand("scene-level")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
