"""`recast scene` and `recast actor`: a street reconstructed from a log, a view-complete vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.shared import JSON, console_for, print_json


@dataclass(frozen=True)
class SceneTrain:
    """Reconstruct the street of a log; the same command resumes from the last checkpoint."""

    log: tyro.conf.Positional[Path]
    """Log folder."""
    out: Path
    """Scene folder to write."""
    preset: Annotated[Literal["streetgs", "omnire"] | None, shared.PRESET] = None
    config: Annotated[Path | None, shared.SCENE_CONFIG] = None
    cameras: Annotated[tuple[str, ...] | None, shared.CAMERAS] = None
    scale: Annotated[float | None, shared.option(shared.SCALE_HELP, "0.5")] = None
    iterations: Annotated[int | None, shared.option(shared.ITERATIONS_HELP, "2800")] = None
    force_dynamic: Annotated[
        tuple[str, ...] | None,
        shared.option(
            "Ids of slow tracks to model as actors all the same.", "none", metavar="ID [ID ...]"
        ),
    ] = None
    seed: Annotated[int | None, shared.SEED] = None
    threads: Annotated[int | None, shared.THREADS] = None
    device: str = "auto"
    """Device of the training: auto (CUDA if there is a GPU and gsplat), cpu, cuda or cuda:1."""

    def __call__(self) -> None:
        from recast.logs import read_log
        from recast.reconstruction import read_config, resolve_config, train_scene
        from recast.runs.display import TrainingDisplay

        names = ("cameras", "scale", "iterations", "force_dynamic", "seed", "threads")
        written = None if self.config is None else read_config(self.config)
        options = {name: getattr(self, name) for name in names}
        config = resolve_config(self.preset, written, options)
        log, console = read_log(self.log), console_for(False)
        with TrainingDisplay(console) as display:
            result = train_scene(log, self.out, config, progress=display, device=self.device)
        console.print(result.budget.explain(), markup=False)


@dataclass(frozen=True)
class Eval:
    """Score a scene on its held-out images, and write images of them.

    Scores: PSNR, SSIM and, with weights, LPIPS of whole images and inside the boxes of moving
    objects; error of the depth at LiDAR points.
    """

    scene: tyro.conf.Positional[Path]
    """Scene folder."""
    log: Path
    """Log folder of the scene."""
    out: Annotated[Path | None, shared.option("Folder of the results.", "SCENE/eval")] = None
    shifts: bool = False
    """Also render novel views: 1, 2 and 3 m to either side, and turned by 5 and 10 degrees. They
    are scored if the log is synthetic."""
    lpips_weights: Annotated[Path | None, shared.LPIPS_WEIGHTS] = None
    workers: int = 0
    """Number of processes that render the ground truth of novel views; 0 uses all cores."""
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.logs import read_log
        from recast.runs.display import evaluate_and_print
        from recast.weights import located

        evaluation = evaluate_and_print(
            self.scene,
            read_log(self.log),
            self.out or self.scene / "eval",
            console_for(self.json),
            shifts=self.shifts,
            lpips=located("--lpips-weights", self.lpips_weights),
            workers=self.workers,
        )
        if self.json:
            from recast.cli.rows.logs import evaluation_rows

            print_json(evaluation_rows(evaluation))


@dataclass(frozen=True)
class SceneExport:
    """Write a scene for other programs: Gaussians, sky image and poses."""

    scene: tyro.conf.Positional[Path]
    """Scene folder."""
    out: Path
    """Folder to write; must not exist."""
    time: Annotated[
        float | None,
        shared.option(
            "Time in seconds after the scene's start: write one file of the street and all actors "
            "at that time.",
            "one file for each part, actors in their own frames",
        ),
    ] = None
    format: Annotated[shared.FormatName, shared.SPLAT_FORMAT] = "ply"

    def __call__(self) -> None:
        from recast.scene import export_scene, export_scene_at, load_scene

        scene = load_scene(self.scene)
        if self.time is None:
            export_scene(scene, self.out, self.format)
            told = f"wrote {self.out}"
        else:
            at_us = export_scene_at(scene, self.out, self.time, self.format)
            told = f"wrote {self.out}, at {at_us} us"
        console_for(False).print(told, markup=False)


@dataclass(frozen=True)
class GaussiansFile:
    """Import a file of Gaussians as a static background: 3DGS PLY, glTF, SPZ or OpenUSD text."""

    background: tyro.conf.Positional[Path]
    """File (.ply, .glb, .spz or .usda)."""
    log: Path
    """Log folder of the drive."""
    out: Path
    """Scene folder to write; must not exist."""
    world_from_file: Annotated[
        Path | None,
        shared.option(
            "Text file with a 4x4 matrix (it may scale) or an offset from the file's coordinates "
            "to the log's world. GLB and SPZ are first turned to x forward, y left, z up.",
            "the same coordinates",
        ),
    ] = None
    sky: Annotated[
        Path | None,
        shared.option(
            "Equirectangular sky image, as `recast scene export` writes it.", "a black sky"
        ),
    ] = None

    def __call__(self) -> None:
        from recast.scene.exchange import import_gaussians

        shared.run_import(import_gaussians, **vars(self))


Import = shared.group(
    "scene import",
    "Import a scene that another program trained (recast docs scenes).",
    {"gaussians": GaussiansFile},
)
Scene = shared.group(
    "scene",
    "Reconstruct, evaluate, import or export a street.",
    {"train": SceneTrain, "eval": Eval, "import": Import, "export": SceneExport},
)


SAMPLING_STEPS = shared.option("Number of sampling steps of structure and latent.", "the model's")
MAX_VOXELS = shared.option(
    "Maximum number of active voxels of a structure.", "8 R^2, 32768 at R = 64"
)


@dataclass(frozen=True)
class Make:
    """Generate actors from the best view of a track, register them to box and LiDAR, and keep
    the vehicle that fits the log best; with a scene, refine it on all images."""

    log: tyro.conf.Positional[Path]
    """Log folder."""
    track: Annotated[str, shared.required(shared.TRACK_HELP)]
    out: Path
    """New folder for observation, actor and turntable."""
    scene: Annotated[
        Path | None,
        shared.option(
            "Scene folder of the log, with a model of the track; the actor is refined on its "
            "images.",
            "no refinement",
        ),
    ] = None
    generator: Annotated[str, shared.GENERATOR] = "auto"
    axes: Annotated[str, shared.AXES] = "auto"
    segmenter: Annotated[str, shared.SEGMENTER] = "box-lidar"
    cameras: Annotated[tuple[str, ...], shared.CAMERAS] = ()
    views: Annotated[int, shared.VIEWS] = 1
    seed: Annotated[int, shared.SEED] = 0
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.core.errors import require_range
        from recast.core.files import atomic_folder
        from recast.logs import read_log
        from recast.reconstruction.config import SceneConfig
        from recast.reconstruction.train import read_training_config, require_log_of
        from recast.runs.actor import ActorMakers, film_turntable, make_actor, refine_actor
        from recast.runs.arms import MOST_VIEWS
        from recast.runs.display import SamplingProgress, print_actor
        from recast.runs.run_folder import TURNTABLE_FILE
        from recast.scene import load_scene

        require_range(1, MOST_VIEWS, views=self.views)
        console = console_for(self.json)
        with atomic_folder(self.out) as folder, SamplingProgress(console) as progress:
            makers = ActorMakers.named(self.generator, self.segmenter, self.axes)
            log = read_log(self.log)
            scene = None if self.scene is None else load_scene(self.scene)
            if self.scene is not None:
                require_log_of(self.scene, log)
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
        if self.json:
            from recast.cli.rows.results import candidate_rows

            print_json(candidate_rows(actor.provenance.candidates))


@dataclass(frozen=True)
class Generate:
    """Generate vehicles from RGBA crops with an image-to-3D model, without a log."""

    crop: Annotated[tyro.conf.Positional[tuple[Path, ...]], shared.several("IMAGE...")]
    """Images with alpha, each of another vehicle; several are generated in one batch."""
    model: Path
    """Model folder in the published layout (pipeline.json, ckpts/), recast-mini (in the package)
    or trellis (recast weights)."""
    out: Path
    """New folder for the vehicles."""
    views: Annotated[tuple[Path, ...], shared.several("PATH [PATH ...]", "optional")] = ()
    """Further images of the same vehicle, in the order front, rear, left, right."""
    seed: Annotated[int, shared.SEED] = 0
    steps: Annotated[int | None, SAMPLING_STEPS] = None
    cfg: Annotated[
        tuple[float, float] | None,
        shared.option(
            "Guidance strengths of structure and latent, such as 7.5 3.",
            "the model's",
            metavar="STRUCTURE LATENT",
        ),
    ] = None
    multi_image: Literal["stochastic", "multidiffusion"] = "stochastic"
    """Use of several views: stochastic (one view at each step, in turn) or multidiffusion (the
    mean of all views at each step)."""
    max_voxels: Annotated[int | None, MAX_VOXELS] = None
    retries: int = 0
    """Number of further seeds to try if a structure is empty or too large."""
    image_encoder: Annotated[Path | None, shared.IMAGE_ENCODER] = None
    device: Annotated[str | None, shared.DEVICE] = None
    precision: Annotated[
        Literal["float16", "bfloat16", "float32"] | None,
        shared.option("Number format of the transformer blocks.", "float16 on CUDA, else float32"),
    ] = None

    def __call__(self) -> None:
        from recast.runs.actor import GenerationRequest, cost_lines, generate_actors, load_model
        from recast.trellis import GenerationLimits
        from recast.weights import located

        request = GenerationRequest(
            self.crop,
            self.views,
            self.seed,
            self.multi_image,
            self.steps,
            self.cfg,
            GenerationLimits(self.max_voxels, self.retries),
        )
        model = load_model(
            located("--model", self.model),
            self.device,
            self.precision,
            located("--image-encoder", self.image_encoder),
        )
        console = console_for(False)
        made = generate_actors(request, model, self.out, console)
        for line in (*cost_lines(made), f"wrote {self.out}"):
            console.print(line, markup=False)


@dataclass(frozen=True)
class Turntable:
    """Write a video of one turn of an actor; a refined actor's seen, mirrored and invented surfaces
    are shown below."""

    actor: tyro.conf.Positional[Path]
    """Actor folder, such as RUN/actors/replaced/actor."""
    out: Path
    """Video to write, such as car.mp4."""

    def __call__(self) -> None:
        from recast.actors import load_actor
        from recast.runs.actor import film_turntable

        film_turntable(load_actor(self.actor), self.out)


@dataclass(frozen=True)
class ActorShow:
    """Draw an actor on one sheet: source image, eight views, seen, mirrored and invented surfaces,
    and provenance."""

    actor: tyro.conf.Positional[Path]
    """Actor folder, such as RUN/actors/replaced/actor."""
    out: Annotated[
        Path | None, shared.option("Image file to write (PNG).", "ACTOR.png, beside the folder")
    ] = None

    def __call__(self) -> None:
        from recast.runs.actor import show_actor

        console_for(False).print(f"wrote {show_actor(self.actor, self.out)}", markup=False)


@dataclass(frozen=True)
class ActorExport:
    """Write an actor for other programs: Gaussians of the vehicle and of its shadow, size and
    conventions."""

    actor: tyro.conf.Positional[Path]
    """Actor folder, such as RUN/actors/replaced/actor."""
    out: Path
    """Folder to write; must not exist."""
    format: Annotated[shared.FormatName, shared.SPLAT_FORMAT] = "ply"

    def __call__(self) -> None:
        from recast.actors import export_actor, load_actor

        export_actor(load_actor(self.actor), self.out, self.format)
        console_for(False).print(f"wrote {self.out}", markup=False)


Actor = shared.group(
    "actor",
    "Make, draw or export a view-complete vehicle, or write a video of it.",
    {
        "make": Make,
        "generate": Generate,
        "turntable": Turntable,
        "show": ActorShow,
        "export": ActorExport,
    },
)
