"""`recast scene`: reconstruct a street, judge it, bring one in, take one out."""

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
        from recast.runs.scene import TrainingDisplay

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
        from recast.runs.scene import evaluate_and_print
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
    "Import a scene that another program trained (docs/scenes.md).",
    {"gaussians": GaussiansFile},
)
Scene = shared.group(
    "scene",
    "Reconstruct, evaluate, import or export a street.",
    {"train": SceneTrain, "eval": Eval, "import": Import, "export": SceneExport},
)
