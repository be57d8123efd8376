"""`recast eval`: judge parts against pictures that they have not seen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from recast.recar.perturb import PerturbationConfig


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
    """AlexNet or VGG-16 weights as torchvision saves them, for LPIPS; or alexnet or vgg16 (see
    recast weights)."""
    clip: Path | None = None
    """Folder of a CLIP model, for the image similarity; or clip-vit-l14 (see recast weights)."""
    dino: Path | None = None
    """Folder of a DINOv2 model, for the feature distance; or dinov2 (see recast weights)."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console
        from rich.progress import Progress

        from recast.evaluation.perceptual import load_distances
        from recast.logs.store import LOG_FILE
        from recast.pipeline.actor import generator_of
        from recast.pipeline.evaluate_actor import evaluate_actors, evaluation_table
        from recast.weights import located

        if (self.set / LOG_FILE).is_file():
            self._judge_tracks()
            return
        distances = load_distances(
            located("--lpips-weights", self.lpips_weights), located("--clip", self.clip),
            located("--dino", self.dino),
        )  # fmt: skip
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

    set: Path
    """Vehicle set, of which the held-out identities are taken, or a folder of real crops."""
    out: Path
    """Folder to write to; the same command resumes there, and models may be added."""
    model: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """NAME=WHAT: a model's name in the tables, and a model folder, a generator or a PLY; or results
    of another generator by vehicle, files:DIR (DIR/ID.ply or .glb) or views:DIR (DIR/ID/VIEW.png,
    RGBA, see recast eval inputs). Give it again for each model, best from the oldest to the newest:
    each is compared with the one before."""
    study: Path | None = None
    """Study file with rows, seed, target views and perturbations; recast eval inputs writes one."""
    perturbed: str | None = None
    """Also judge on perturbed pictures: a perturbation file, or the word default."""
    targets: Literal["set", "orbit"] = "set"
    """Views that are compared: the set's own cameras; or the paper's orbit, 512 x 512 pixels, 40
    degrees, twice the longest side of the box away, photographs scaled to it."""
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
    """AlexNet or VGG-16 weights as torchvision saves them, for LPIPS; or alexnet or vgg16 (see
    recast weights)."""
    clip: Path | None = None
    """Folder of a CLIP model, for the image similarity; or clip-vit-l14 (see recast weights)."""
    dino: Path | None = None
    """Folder of a DINOv2 model, for its feature and Frechet distances; or dinov2 (see recast
    weights)."""
    inception: Path | None = None
    """Weights of the FID's Inception network or of torchvision's, for the Frechet distance; or
    inception (see recast weights)."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.evaluation.generation_report import (
            differences_table,
            paper_table,
            study_table,
        )
        from recast.pipeline.generation_maker import Measures
        from recast.pipeline.generation_plan import StudySettings
        from recast.pipeline.generation_rows import parse_models, read_rows
        from recast.pipeline.generation_study import run_study
        from recast.recar.progress import PictureProgress
        from recast.weights import located

        models, beside = parse_models(self.model), dict[str, str]()
        seed, targets, perturbations = self.seed, self.targets, _perturbations(self.perturbed)
        if self.study is not None:
            self._refuse_twice()
            record, rows = read_rows(self.study)
            models, beside = {**rows, **models}, record.beside()
            seed, targets, perturbations = record.seed, record.targets, record.perturbations
        settings = StudySettings(
            models, self.set, seed, self.limit, perturbations, self.placement,
            Measures(
                located("--lpips-weights", self.lpips_weights), located("--clip", self.clip),
                located("--dino", self.dino), located("--inception", self.inception),
            ), self.samples, self.shown, targets, beside,
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
        if beside:
            console.print(paper_table(blocks[0], beside))
        console.print(f"wrote {self.out}", markup=False)

    def _refuse_twice(self) -> None:
        from recast.errors import InputError

        for option, given in (
            ("--seed", self.seed != 0),
            ("--targets", self.targets != "set"),
            ("--perturbed", self.perturbed is not None),
        ):
            if given:
                raise InputError(option, "value", "is in the study file", "leave it out")


@dataclass(frozen=True)
class EvalInputs:
    """Write what generators that run elsewhere need: the picture that each vehicle is made from,
    the cameras of the views it is compared in, and a study file with the rows of the paper."""

    set: tyro.conf.Positional[Path]
    """Vehicle set, of which the held-out identities are taken, or a folder of real crops."""
    out: Path
    """New folder to write to."""
    perturbed: str | None = None
    """Also write perturbed pictures: a perturbation file, or the word default."""
    targets: Literal["set", "orbit"] = "set"
    """Views that are compared, as for recast eval generation."""
    seed: int = 0
    """Seed of the choice of the pictures, and of the perturbations."""
    limit: int | None = None
    """Only this many vehicles, the first by id; all where not given."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.generation_inputs import write_inputs
        from recast.pipeline.generation_plan import StudySettings

        settings = StudySettings(
            {}, self.set, self.seed, self.limit, _perturbations(self.perturbed),
            targets=self.targets,
        )  # fmt: skip
        cases = write_inputs(settings, self.out)
        Console().print(f"wrote {self.out}: inputs of {len(cases)} vehicles", markup=False)


def _perturbations(what: str | None) -> PerturbationConfig | None:
    from recast.recar.perturb import PerturbationConfig, read_perturbations

    if what is None:
        return None
    return PerturbationConfig() if what == "default" else read_perturbations(what)


@dataclass(frozen=True)
class Eval:
    """Judge what makes vehicles, by pictures of them that it has not seen."""

    command: (
        Annotated[EvalActor, tyro.conf.subcommand("actor")]
        | Annotated[EvalGeneration, tyro.conf.subcommand("generation")]
        | Annotated[EvalInputs, tyro.conf.subcommand("inputs")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
