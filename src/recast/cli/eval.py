"""`recast eval`: judge parts against pictures that they have not seen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class EvalActor:
    """Make vehicles from one or several pictures and compare them with reserved ones; or make and
    refine those of a log's tracks and compare them with the images that its scene held out."""

    model: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="MODEL")]
    """What makes the vehicles: template, an installed generator, a vehicle file, a model folder."""
    set: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SET")]
    """Folder of real crops (ID/input_views, ID/reserved_views), a vehicle set, or a log."""
    out: Path
    """Folder to write metrics.json and a picture of every vehicle to; must not exist."""
    scene: Path | None = None
    """With a log: its scene folder, with models of the tracks."""
    track: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """With a log: a track to judge; give it again for each."""
    segmenter: str = "box-lidar"
    """With a log: what cuts the vehicles out, as for recast actor make."""
    axes: str = "auto"
    """Axes of a PLY or a model folder: which one points up, such as z-up, y-up or minus-y-up (a
    splat viewer's), or forward and up, such as x,z (write --axes=-y,z with a minus). auto tells a
    PLY's from its shape, and takes models for z-up."""
    seed: int = 0
    """Seed of everything random."""
    limit: int | None = None
    """Judge only this many vehicles, the first by id; all where not given."""
    views: int = 1
    """Number of input pictures to make each vehicle from, at most."""
    lpips_weights: Path | None = None
    """AlexNet or VGG-16 weights as torchvision saves them, for LPIPS."""
    clip: Path | None = None
    """Folder of a CLIP model, for the image similarity."""
    dino: Path | None = None
    """Folder of a DINOv2 model, for the feature distance."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console
        from rich.progress import Progress

        from recast.evaluation.perceptual import load_distances
        from recast.logs.store import LOG_FILE
        from recast.pipeline.actor import generator_of
        from recast.pipeline.evaluate_actor import evaluate_actors, evaluation_table

        if (self.set / LOG_FILE).is_file():
            self._judge_tracks()
            return
        distances = load_distances(self.lpips_weights, self.clip, self.dino)
        generator = generator_of(self.model, self.axes)
        console = Console()
        with Progress(console=console, transient=True) as progress:
            task = progress.add_task("vehicles", total=None)
            evaluation = evaluate_actors(
                generator,
                self.set,
                self.out,
                seed=self.seed,
                limit=self.limit,
                views=self.views,
                distances=distances,
                progress=lambda done, of: progress.update(task, completed=done, total=of),
            )
        console.print(evaluation_table(evaluation))
        for vehicle, reason in evaluation.failures.items():
            console.print(f"not made: {vehicle}: {reason}", markup=False)
        console.print(f"wrote {self.out}", markup=False)

    def _judge_tracks(self) -> None:
        from rich.console import Console

        from recast.errors import InputError
        from recast.logs import read_log
        from recast.pipeline.actor import ActorMakers
        from recast.pipeline.display import SamplingProgress
        from recast.pipeline.evaluate_tracks import evaluate_tracks, tracks_table
        from recast.scene import load_scene, read_training_config

        if self.scene is None:
            raise InputError("--scene", "scene", "is not given", "name the scene of this log")
        makers = ActorMakers.named(self.model, self.segmenter, self.axes)
        console = Console()
        with SamplingProgress(console) as progress:
            results = evaluate_tracks(
                read_log(self.set), load_scene(self.scene), read_training_config(self.scene),
                self.track, makers, self.out, self.seed, progress,
            )  # fmt: skip
        console.print(tracks_table(results))
        console.print(f"wrote {self.out}", markup=False)


@dataclass(frozen=True)
class EvalGeneration:
    """Compare models that make vehicles from one picture, on clean and on perturbed pictures."""

    model: tyro.conf.UseAppendAction[tuple[str, ...]]
    """NAME=WHAT: a model's name in the tables, and a model folder, a generator or a PLY; give it
    again for each model, best from the oldest to the newest: each is compared with the one before.
    """
    set: Path
    """Vehicle set, of which the held-out identities are taken, or a folder of real crops."""
    out: Path
    """Folder to write to; the same command resumes there, and models may be added."""
    perturbed: str | None = None
    """Also judge on perturbed pictures: a perturbation file, or the word default."""
    placement: Literal["views", "canonical"] = "views"
    """How vehicles are placed in their box: by the conditioning view as `recast eval actor` does,
    or by the models' own forward axis, which they then must have been taught."""
    seed: int = 0
    """Seed of everything random."""
    limit: int | None = None
    """Judge only this many vehicles, the first by id; all where not given."""
    workers: int = 1
    """Processes; the files are the same for any number."""
    samples: int = 200_000
    """Bootstrap samples of the intervals."""
    shown: int = 40
    """Vehicles on the picture sheets, the first by id."""
    lpips_weights: Path | None = None
    """AlexNet or VGG-16 weights as torchvision saves them, for LPIPS."""
    clip: Path | None = None
    """Folder of a CLIP model, for the image similarity."""
    dino: Path | None = None
    """Folder of a DINOv2 model, for its feature and Frechet distances."""
    inception: Path | None = None
    """Weights of the FID's Inception network or of torchvision's, for the Frechet distance."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.evaluation.generation_report import differences_table, study_table
        from recast.pipeline.generation_maker import Measures
        from recast.pipeline.generation_plan import StudySettings, parse_models
        from recast.pipeline.generation_study import run_study
        from recast.recar.perturb import PerturbationConfig, read_perturbations
        from recast.recar.progress import PictureProgress

        config = None
        if self.perturbed is not None:
            named = self.perturbed != "default"
            config = read_perturbations(self.perturbed) if named else PerturbationConfig()
        settings = StudySettings(
            parse_models(self.model), self.set, self.seed, self.limit, config, self.placement,
            Measures(self.lpips_weights, self.clip, self.dino, self.inception), self.samples,
            self.shown,
        )  # fmt: skip
        console = Console()
        with PictureProgress("vehicles", console) as progress:
            blocks = run_study(settings, self.out, workers=self.workers, progress=progress)
        for block in blocks:
            console.print(study_table(block))
            if block.differences:
                console.print(differences_table(block))
            for model, failed in block.failures.items():
                for vehicle, reason in failed.items():
                    console.print(f"not made by {model}: {vehicle}: {reason}", markup=False)
        console.print(f"wrote {self.out}", markup=False)


@dataclass(frozen=True)
class Eval:
    """Judge what makes vehicles, by pictures of them that it has not seen."""

    command: (
        Annotated[EvalActor, tyro.conf.subcommand("actor")]
        | Annotated[EvalGeneration, tyro.conf.subcommand("generation")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
