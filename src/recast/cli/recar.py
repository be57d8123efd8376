"""`recast recar`: vehicle sets, pseudo-targets, and the adaptation to vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.recar_sets import Ingest, Perturb, RecarCamera, Screen
from recast.cli.scene import MAX_VOXELS, SAMPLING_STEPS
from recast.cli.shared import JSON, console_for, print_json


@dataclass(frozen=True)
class RecarTargets:
    """Make a pseudo-target of every vehicle of a set from its front, rear, left and right view.

    The same command resumes; finished targets stay.
    """

    set: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SET")]
    """Vehicle set."""
    model: Path
    """Model folder in the published layout (pipeline.json, ckpts/), recast-mini (in the package)
    or trellis (recast weights)."""
    out: Path
    """Cache folder; the same command resumes, and a larger set extends the cache."""
    seed: Annotated[int, shared.SEED] = 0
    limit: Annotated[int | None, shared.LIMIT] = None
    workers: Annotated[int, shared.WORKERS] = 1
    ray: Annotated[str | None, shared.RAY] = None
    image_encoder: Annotated[Path | None, shared.IMAGE_ENCODER] = None
    device: Annotated[str | None, shared.DEVICE] = None
    multi_image: Literal["stochastic", "multidiffusion"] = "stochastic"
    """Use of the four views: stochastic (one view at each step, in turn, as in the paper) or
    multidiffusion (the mean of all views at each step, at four times the cost)."""
    steps: Annotated[int | None, SAMPLING_STEPS] = None
    retries: int = 3
    """Number of further seeds to try if a structure is empty or too large."""
    max_voxels: Annotated[int | None, MAX_VOXELS] = None
    filter: Literal["agreement", "aesthetic", "none"] = "agreement"
    """Quality filter: agreement with the images, the Improved Aesthetic Predictor, or none."""
    heading: Literal["any", "+x"] = "any"
    """Heading of the model's vehicles: any (found from the images) or +x (models trained so)."""
    threshold: Annotated[
        float | None,
        shared.option(
            "Minimum score of a target; may be changed later.",
            "4.5 of the aesthetic predictor, 0.6 of the agreement",
        ),
    ] = None
    predictor: Annotated[
        Path | None,
        shared.option(
            "Weights of the aesthetic predictor (sac+logos+ava1-l14-linearMSE.pth), or aesthetic "
            "(recast weights)."
        ),
    ] = None
    clip: Annotated[
        Path | None,
        shared.option(
            "CLIP ViT-L/14 for the aesthetic predictor: a folder, or clip-vit-l14 (recast weights)."
        ),
    ] = None
    retry_failures: bool = False
    """Try again the vehicles that failed before."""
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from itertools import islice

        from recast.core.diagnostics import ProgressBar
        from recast.core.errors import require_range
        from recast.recar.target_maker import FilterSettings, ModelSource, TargetSettings
        from recast.recar.targets import build_targets, target_statistics, target_table
        from recast.recar.vehicle_set import read_set
        from recast.trellis.checkpoints import read_pipeline
        from recast.weights import located

        require_range(0, seed=self.seed, retries=self.retries)
        require_range(1, limit=self.limit, max_voxels=self.max_voxels, steps=self.steps)
        vehicles = read_set(self.set)
        model = located("--model", self.model)
        pipeline = read_pipeline(model)
        settings = TargetSettings(
            seed=self.seed,
            mode=self.multi_image,
            structure=pipeline.sparse_structure_settings.merged(steps=self.steps),
            latent=pipeline.slat_settings.merged(steps=self.steps),
            retries=self.retries,
            max_voxels=self.max_voxels,
            heading=self.heading,
            filter=FilterSettings(
                kind=self.filter,
                threshold=self.threshold,
                predictor=located("--predictor", self.predictor),
                clip=located("--clip", self.clip),
            ),
        )
        console = console_for(self.json)
        with ProgressBar("targets", console) as progress:
            cache = build_targets(
                vehicles,
                ModelSource(model, located("--image-encoder", self.image_encoder), self.device),
                self.out,
                settings,
                workers=self.workers,
                ray=self.ray,
                identities=None
                if self.limit is None
                else set(islice(vehicles.identities, self.limit)),
                retry_failures=self.retry_failures,
                progress=progress,
            )
        if self.json:
            from recast.cli.rows.results import target_rows

            print_json(target_rows(cache, target_statistics(cache)))
            return
        console.print(target_table(cache, target_statistics(cache)))


@dataclass(frozen=True)
class RecarSynth:
    """Render a set of parametric vehicles from all sides, with labels and without background."""

    vehicles: int
    """Number of vehicles."""
    out: Path
    """Set folder; the same command resumes, and a set of the same settings grows."""
    seed: Annotated[int, shared.SEED] = 0
    views: int = 30
    """Number of images of each vehicle, at regular azimuths; the first shows its front."""
    width: int = 1200
    """Width of the images in pixels."""
    height: int = 800
    """Height of the images in pixels."""
    kinds: Annotated[
        tuple[str, ...],
        shared.option(
            "Kinds of vehicles, each equally often.",
            "all, as often as on the road",
            metavar="KIND [KIND ...]",
        ),
    ] = ()
    shapes: int = 0
    """Number of other shapes, such as furniture and signs."""
    mesh: Annotated[
        tyro.conf.UseAppendAction[tuple[Path, ...]],
        shared.option("Closed mesh (glTF, OBJ, PLY, STL) to include. May be repeated."),
    ] = ()
    mesh_axes: Annotated[
        str | None,
        shared.option(
            "Forward and up axes of the meshes, such as x,z (write --mesh-axes=-y,z with a minus).",
            "z,y for glTF, x,z for other formats",
            metavar="AXES",
        ),
    ] = None
    licence: str = "CC0-1.0"
    """Licence of the images, written to set.json."""
    held_out: float = 0.05
    """Share of the vehicles that is held out of training (0 to 1)."""
    workers: Annotated[int, shared.WORKERS] = 1

    def __call__(self) -> None:
        from recast.core.diagnostics import ProgressBar
        from recast.recar import SynthesisSettings, synthesize_set

        settings = SynthesisSettings(
            self.seed, self.views, self.width, self.height, self.kinds, self.licence, self.held_out
        )
        console = console_for(False)
        with ProgressBar("pictures", console) as progress:
            made = synthesize_set(
                self.out,
                self.vehicles,
                settings,
                shapes=self.shapes,
                meshes=self.mesh,
                mesh_axes=self.mesh_axes,
                workers=self.workers,
                progress=progress,
            )
        console.print(f"wrote {self.out}: {len(made.identities)} identities", markup=False)


@dataclass(frozen=True)
class Stats:
    """Count the vehicles of a set, check its images, and draw an overview."""

    set: tyro.conf.Positional[Path]
    """Set folder."""
    sheet: Annotated[
        Path | None,
        shared.option("Image to write (PNG): vehicles from all sides, colours and kinds.", "none"),
    ] = None
    decode: bool = False
    """Check every pixel instead of every header (minutes to hours)."""
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.core.diagnostics import ProgressBar
        from recast.recar import read_set, set_statistics, statistics_table
        from recast.recar.screening import write_overview

        vehicle_set = read_set(self.set)
        console = console_for(self.json)
        with ProgressBar("checked", console) as progress:
            vehicle_set.check_pictures(self.decode, progress)
        statistics = set_statistics(vehicle_set)
        if self.json:
            from recast.cli.rows.results import set_rows

            print_json(set_rows(statistics))
        else:
            console.print(statistics_table(vehicle_set, statistics))
        if self.sheet is not None:
            write_overview(vehicle_set, statistics, self.sheet)
            console.print(f"wrote {self.sheet}", markup=False)


@dataclass(frozen=True)
class RecarTrain:
    """Train the flows of an image-to-3D model towards pseudo-targets; the same command resumes.

    On several GPUs: torchrun --nproc-per-node 2 -m recast.cli.main recar train ...
    """

    model: Path
    """Model folder to start from (published layout), recast-mini (in the package) or trellis
    (recast weights)."""
    targets: Path
    """Cache of pseudo-targets, from `recast recar targets`."""
    set: Path
    """Vehicle set with the images, or a folder of training assets."""
    out: Path
    """Folder of the new model; the same command resumes."""
    stage: Annotated[
        Literal["1", "2", "base", "base-2", "mini-1", "mini-2"] | None,
        shared.option(
            "Stage of the paper: 1 (vehicles) or 2 (perturbed images); of the small model: base, "
            "base-2, mini-1 or mini-2."
        ),
    ] = None
    config: Annotated[
        Path | None,
        shared.option(
            'JSON file with all settings of a stage, or "preset" and the changes; instead of '
            "--stage."
        ),
    ] = None
    flow: Annotated[
        tyro.conf.UseAppendAction[tuple[Literal["structure", "latent"], ...]],
        shared.option(
            "Flow to train in this process; the model is written after the last flow.", "both"
        ),
    ] = ()
    image_encoder: Annotated[Path | None, shared.IMAGE_ENCODER] = None
    device: Annotated[str | None, shared.DEVICE] = None
    tensorboard: bool = False
    """Also write TensorBoard curves to OUT/tensorboard."""

    def __call__(self) -> None:
        from rich.console import Console

        from recast.recar.training import StageRequest, train_stage
        from recast.recar.training_config import chosen_stage
        from recast.training.loop import Processes
        from recast.weights import located

        config = chosen_stage(self.stage, self.config)
        request = StageRequest(
            config,
            located("--model", self.model),
            self.targets,
            self.set,
            self.out,
            located("--image-encoder", self.image_encoder),
            self.device,
            self.tensorboard,
            self.flow,
        )
        processes = Processes.started()
        left = train_stage(request, processes=processes)
        said = f"{self.out}: {', '.join(left)} still to train" if left else f"wrote {self.out}"
        Console(quiet=not processes.first).print(said, markup=False, soft_wrap=True)


Recar = shared.group(
    "recar",
    "Make vehicle sets, and adapt the image-to-3D model to vehicles.",
    {
        "synth": RecarSynth,
        "stats": Stats,
        "ingest": Ingest,
        "camera": RecarCamera,
        "targets": RecarTargets,
        "perturb": Perturb,
        "screen": Screen,
        "train": RecarTrain,
    },
)
