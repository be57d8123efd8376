"""`recast actor`: a view-complete vehicle from a log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Make:
    """Generate vehicles from a track's best view, register them to box and LiDAR, and take the one
    that fits the log best; with a scene, have it follow all images."""

    log: tyro.conf.Positional[Path]
    """Log folder."""
    track: str
    """Track to make; `recast log info LOG` lists them."""
    out: Path
    """Folder to write observation, actor and turntable to; must not exist."""
    scene: Path | None = None
    """Scene folder of the log, with a model of the track: the actor is refined against it."""
    generator: str = "auto"
    """What makes the vehicle: auto (template and recast-mini, of which the log's evidence takes the
    best), recast-mini (the image-to-3D model of the package), template, an installed generator's
    name, trellis (see recast weights), a model folder, the path of a PLY, GLB or OBJ, or
    library:FOLDER (the best of the files and actors in it)."""
    axes: str = "auto"
    """Axes of vehicle files or a model folder: which one points up, such as z-up, y-up or
    minus-y-up (a splat viewer's), or forward and up, such as x,z (write --axes=-y,z with a minus).
    auto tells a file's from its shape, and takes models for z-up."""
    segmenter: str = "box-lidar"
    """What cuts the vehicle out: box-lidar, an installed segmenter's name, grounded-sam (see recast
    weights), or a folder that holds grounding-dino and sam (see docs/actors.md)."""
    cameras: tuple[str, ...] = ()
    """Cameras that the views may be taken from. Default: all of the log."""
    views: int = 1
    """Number of views to use at most: the best one and others that show other sides. Frames that
    scenes hold out by default (every eighth) are never used."""
    seed: int = 0
    """Seed of everything random."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.errors import InputError
        from recast.logs import read_log
        from recast.pipeline.actor import ActorMakers, film_turntable, make_actor, refine_actor
        from recast.pipeline.arms import MOST_VIEWS
        from recast.pipeline.display import SamplingProgress, print_actor
        from recast.pipeline.layout import TURNTABLE_FILE
        from recast.scene import SceneConfig, load_scene, read_training_config
        from recast.storage import atomic_folder

        if not 1 <= self.views <= MOST_VIEWS:
            raise InputError("--views", "value", f"is {self.views}", f"give 1 to {MOST_VIEWS}")
        console = Console()
        with atomic_folder(self.out) as folder, SamplingProgress(console) as progress:
            makers = ActorMakers.named(self.generator, self.segmenter, self.axes)
            log = read_log(self.log)
            scene = None if self.scene is None else load_scene(self.scene)
            config = SceneConfig() if self.scene is None else read_training_config(self.scene)
            if self.cameras:
                config = config.model_copy(update={"cameras": self.cameras})
            actor = make_actor(
                log, self.track, makers, self.seed, folder, config, self.views, progress
            )
            if scene is not None:
                actor = refine_actor(folder, scene, self.seed, folder / "refined", progress)
            film_turntable(actor, folder / TURNTABLE_FILE)
        console.print(actor.provenance.observation, markup=False)
        print_actor(actor, console)
        if actor.provenance.refinement is not None:
            console.print(actor.provenance.refinement.explain(), markup=False, highlight=False)
        console.print(f"wrote {self.out}", markup=False)


@dataclass(frozen=True)
class Generate:
    """Generate vehicles from RGBA crops with an image-to-3D model, without a log."""

    crop: tyro.conf.Positional[tuple[Path, ...]]
    """Pictures with alpha, each of another vehicle; several are generated in one batch."""
    model: Path
    """Model folder in the published layout (pipeline.json, ckpts/), or trellis (see recast
    weights)."""
    out: Path
    """Folder to write to; must not exist."""
    views: tuple[Path, ...] = ()
    """Further pictures of the same vehicle, in the order front, rear, left, right."""
    seed: int = 0
    """Seed of everything random."""
    steps: int | None = None
    """Sampling steps of structure and latent; the model's where not given."""
    cfg: tuple[float, float] | None = None
    """Guidance strengths of structure and latent, such as 7.5 3; the model's where not given."""
    multi_image: Literal["stochastic", "multidiffusion"] = "stochastic"
    """How several views are used: one a step in turn, or the mean of all in each step."""
    max_voxels: int | None = None
    """Refuse a structure of more active voxels; 8 R^2 (32768 at R = 64) where not given."""
    retries: int = 0
    """Further seeds to try where a structure is empty or too large."""
    image_encoder: Path | None = None
    """Weights of the published image encoder (DINOv2 ViT-L/14 with registers), where the model
    folder has none; or dinov2 (see recast weights)."""
    device: str | None = None
    """Such as cpu or cuda:0; CUDA where there is some."""
    precision: Literal["float16", "bfloat16", "float32"] | None = None
    """Of the transformer blocks; float16 on CUDA, else float32."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.generate_actor import (
            GenerationRequest,
            cost_lines,
            generate_actors,
            load_model,
        )
        from recast.trellis import GenerationLimits
        from recast.weights import located

        request = GenerationRequest(
            self.crop, self.views, self.seed, self.multi_image, self.steps, self.cfg,
            GenerationLimits(self.max_voxels, self.retries),
        )  # fmt: skip
        model = load_model(
            located("--model", self.model), self.device, self.precision,
            located("--image-encoder", self.image_encoder),
        )  # fmt: skip
        console = Console()
        made = generate_actors(request, model, self.out, console)
        for line in (*cost_lines(made), f"wrote {self.out}"):
            console.print(line, markup=False)


@dataclass(frozen=True)
class Turntable:
    """Film an actor turning once; below it, what of a refined one was seen, mirrored or
    invented."""

    actor: tyro.conf.Positional[Path]
    """Actor folder, such as RUN/actors/replaced/actor."""
    out: Path
    """Film to write, such as car.mp4."""

    def __call__(self) -> None:
        """Run the command."""
        from recast.actors import load_actor
        from recast.pipeline.actor import film_turntable

        film_turntable(load_actor(self.actor), self.out)


@dataclass(frozen=True)
class Show:
    """Draw an actor on one sheet: source, eight views, what was seen, mirrored or invented, and how
    it was made."""

    actor: tyro.conf.Positional[Path]
    """Actor folder, such as RUN/actors/replaced/actor."""
    out: Path | None = None
    """Picture to write (PNG); must not exist. Default: ACTOR.png, beside the folder."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.show_actor import show_actor

        Console().print(f"wrote {show_actor(self.actor, self.out)}", markup=False)


@dataclass(frozen=True)
class Actor:
    """A view-complete vehicle from a log."""

    command: (
        Annotated[Make, tyro.conf.subcommand("make")]
        | Annotated[Generate, tyro.conf.subcommand("generate")]
        | Annotated[Turntable, tyro.conf.subcommand("turntable")]
        | Annotated[Show, tyro.conf.subcommand("show")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
