"""`recast scene`: reconstruct a street, judge it, bring one in, take one out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli.scene_import import Import


@dataclass(frozen=True)
class Train:
    """Reconstruct the street of a log; resumes from its last checkpoint when run again."""

    log: tyro.conf.Positional[Path]
    """Log folder."""
    out: Path
    """Scene folder to write."""
    preset: Literal["streetgs", "omnire"] | None = None
    """Train by the method of Street Gaussians or of OmniRe; recast's own where none is named."""
    config: Path | None = None
    """Configuration file (JSON, see docs/scenes.md): goes before the preset, and the options below
    before both."""
    cameras: tuple[str, ...] | None = None
    """Cameras to train on; all of the log where none is named."""
    scale: float | None = None
    """Image scale: 0.5 trains at half the recorded width and height."""
    iterations: int | None = None
    """Training steps."""
    force_dynamic: tuple[str, ...] | None = None
    """Tracks to model as actors though they hardly move."""
    seed: int | None = None
    """Seed of everything random."""
    threads: int | None = None
    """CPU threads, 0 for all."""
    device: str = "auto"
    """auto, cpu, cuda or cuda:1; auto is CUDA where there are a GPU and gsplat."""

    def __call__(self) -> None:
        """Run the command."""
        from recast.logs import read_log
        from recast.pipeline.scene import train_with_display
        from recast.scene import read_config, resolve_config

        names = ("cameras", "scale", "iterations", "force_dynamic", "seed", "threads")
        written = None if self.config is None else read_config(self.config)
        options = {name: getattr(self, name) for name in names}
        config = resolve_config(self.preset, written, options)
        train_with_display(read_log(self.log), self.out, config, device=self.device)


@dataclass(frozen=True)
class Eval:
    """How well a scene redraws the images that were kept from its training, with pictures.

    PSNR, SSIM and, with its weights, LPIPS of whole images and inside the boxes of what moves, and
    depth against the LiDAR.
    """

    scene: tyro.conf.Positional[Path]
    """Scene folder."""
    log: Path
    """Log folder the scene was made from."""
    out: Path | None = None
    """Folder to write to; SCENE/eval where none is named."""
    shifts: bool = False
    """Also look from 1, 2 and 3 m to either side and turned by 5 and 10 degrees: scored where the
    log is synthetic, so that the truth is known, and pictures alone where it is not."""
    lpips_weights: Annotated[Path | None, tyro.conf.arg(aliases=("--lpips",))] = None
    """AlexNet or VGG-16 weights as torchvision saves them, for LPIPS; or alexnet or vgg16 (see
    recast weights)."""
    workers: int = 0
    """Processes that render the truth of shifted views; 0 for one for each core."""

    def __call__(self) -> None:
        """Run the command."""
        from recast.logs import read_log
        from recast.pipeline.scene import evaluate_and_print
        from recast.weights import located

        evaluate_and_print(
            self.scene,
            read_log(self.log),
            self.out or self.scene / "eval",
            shifts=self.shifts,
            lpips=located("--lpips-weights", self.lpips_weights),
            workers=self.workers,
        )


@dataclass(frozen=True)
class Export:
    """Write a scene for other programs: PLY files, sky image and poses."""

    scene: tyro.conf.Positional[Path]
    """Scene folder."""
    out: Path
    """Folder to write; must not exist."""
    time: float | None = None
    """Seconds after the scene's first time: one PLY of all that is there then. Without it, one PLY
    a part, actors in their own frames."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.scene import export_scene, export_scene_at, load_scene

        scene = load_scene(self.scene)
        if self.time is None:
            export_scene(scene, self.out)
            told = f"wrote {self.out}"
        else:
            told = f"wrote {self.out}, at {export_scene_at(scene, self.out, self.time)} us"
        Console().print(told, markup=False)


@dataclass(frozen=True)
class Scene:
    """Reconstruct a street, judge it, bring one in, take one out."""

    command: (
        Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Eval, tyro.conf.subcommand("eval")]
        | Annotated[Import, tyro.conf.subcommand("import")]
        | Annotated[Export, tyro.conf.subcommand("export")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
