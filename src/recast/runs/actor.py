"""The actor of a run, from observation to video, and vehicles that are generated from crops."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from rich.console import Console

from recast.actors import (
    AUTO,
    Actor,
    ActorGenerator,
    Observation,
    Segmenter,
    insert,
    load_actor,
    make_generator,
    observe,
    orbit,
    save_actor,
    segmenter_of,
)
from recast.actors.evidence import load_evidence, save_evidence
from recast.actors.generate import candidates_of
from recast.actors.insert import require_model
from recast.actors.observation import Usable
from recast.actors.observe import gather_evidence, track_of, training_frames
from recast.actors.refine import refine
from recast.actors.register import choose
from recast.core import files
from recast.core.diagnostics import Progress, ProgressBar
from recast.core.errors import InputError
from recast.geometry import boxes, se3
from recast.logs import DrivingLog
from recast.metrics import evaluate_oracle_views
from recast.reconstruction import SceneConfig
from recast.reporting.previews import draw_actor_sheet, turntable_frames
from recast.reporting.video import write_video
from recast.runs.completion import require_made
from recast.runs.display import SamplingProgress, truth_table
from recast.runs.run_folder import (
    ACTOR_FOLDER,
    EVIDENCE_FILE,
    OBSERVATION_FOLDER,
    REFINEMENT_CHECKPOINT,
    TURNTABLE_FILE,
    VIEWS_FOLDER,
)
from recast.runs.sources import SourceLog
from recast.scene import StreetScene
from recast.simulation import camera_mounts
from recast.splats import Gaussians, LowPass, write_ply
from recast.synthetic import Oracle
from recast.trellis import (
    GeneratedVehicle,
    Generation,
    GenerationLimits,
    ImageTo3D,
    MultiImageMode,
    SamplerSettings,
    crop_to_object,
    generate,
    read_crop,
    viewer_frame,
)

StageProgress = Callable[[str, int, int], None]

_TURNTABLE_VIEWS = 72
_TURNTABLE_SIZE = (640, 360)
_BOX_COLOUR = (255, 170, 0)


@dataclass(frozen=True)
class ActorMakers:
    """What cuts a vehicle out and what generates it, their networks in memory."""

    generator: ActorGenerator
    segmenter: Segmenter

    @classmethod
    def named(cls, generator: str, segmenter: str, axes: str = AUTO) -> Self:
        """Those of these names, see `make_generator` and `segmenter_of`.

        Raises:
            InputError: there is none of a name, or it cannot be loaded.
        """
        return cls(make_generator(generator, axes), segmenter_of(segmenter))


def make_actor(
    log: DrivingLog,
    track_id: str,
    makers: ActorMakers,
    seed: int,
    out: Path,
    config: SceneConfig,
    views: int = 1,
    progress: StageProgress | None = None,
    usable: Usable | None = None,
) -> Actor:
    """Observe, gather evidence, generate candidates, register and choose.

    Writes `observation/` with the evidence, and `actor/` below `out`. InputError: see `observe` and
    `choose`.

    Args:
        config: settings of the street's scene: cameras, image scale, and the frames that are held
            out.
        views: largest number of views of the track that a generator is given.
        progress: function that is told the stage, the pieces done, and all pieces of the stage.
        usable: tells which frames may be looked at; None: those that are not held out.
    """
    require_made(makers.generator.name, track_of(log, track_id), "`generator`")
    usable = training_frames(config) if usable is None else usable
    observation = observe(
        log,
        track_id,
        segmenter=makers.segmenter,
        cameras=config.cameras,
        views=views,
        usable=usable,
    )
    evidence = gather_evidence(
        log,
        track_id,
        segmenter=makers.segmenter,
        config=config,
        hits=observation.points,
        usable=usable,
        progress=_stage(progress, "images"),
    )
    with files.atomic_folder(out / OBSERVATION_FOLDER) as folder:
        save_observation(observation, log, folder)
        save_evidence(evidence, folder / Path(EVIDENCE_FILE).name)
    candidates = candidates_of(makers.generator, observation, seed)
    choice = choose(candidates, observation, log, evidence, _stage(progress, "vehicles"))
    save_actor(choice.actor, out / ACTOR_FOLDER)
    return choice.actor


def refine_actor(
    registered: Path,
    scene: StreetScene,
    seed: int,
    out: Path,
    progress: StageProgress | None = None,
) -> Actor:
    """Refine the actor of a folder that `make_actor` wrote, against a street.

    Writes `actor/` below `out`, and goes on where it was stopped there.

    Raises:
        InputError: something of the folder is missing or broken; the scene has no such track.
    """
    actor = load_actor(registered / ACTOR_FOLDER)
    require_model(scene, actor.track_id)
    evidence = load_evidence(registered / EVIDENCE_FILE).posed_by(scene)
    checkpoint = out / REFINEMENT_CHECKPOINT
    refined = refine(
        actor, evidence, scene, seed, checkpoint=checkpoint, progress=_stage(progress, "refinement")
    )
    if (out / ACTOR_FOLDER).exists():  # a kill between the folder and the removal below
        shutil.rmtree(out / ACTOR_FOLDER)
    save_actor(refined, out / ACTOR_FOLDER)
    checkpoint.unlink(missing_ok=True)
    return refined


def _stage(progress: StageProgress | None, name: str) -> Progress | None:
    return None if progress is None else partial(progress, name)


def film_turntable(actor: Actor, path: Path) -> None:
    """Write a film of an actor turning once in six seconds, its shares below if it has some."""
    frames = turntable_frames(actor, _TURNTABLE_VIEWS, *_TURNTABLE_SIZE)
    write_video(path, frames, fps=_TURNTABLE_VIEWS / 6)


def save_observation(observation: Observation, log: DrivingLog, folder: Path) -> None:
    """Write each crop, the frame it was cut from with the box drawn in, and why these views."""
    for number, view in enumerate(observation.views, 1):
        mark = "" if number == 1 else f"_{number}"
        Image.fromarray(view.rgba, "RGBA").save(folder / f"crop{mark}.png")
        Image.fromarray(_frame_with_box(view, log)).save(folder / f"frame{mark}.png")
    files.write_text(folder / "explanation.txt", observation.explain() + "\n")


def _frame_with_box(observation: Observation, log: DrivingLog) -> NDArray[np.uint8]:
    stream = log.cameras[observation.view.camera]
    frame = observation.view.frame
    image = np.ascontiguousarray(stream.images[frame])
    time = int(stream.timestamps_us[frame])
    pose = log.tracks[observation.track_id].trajectory.at(time)
    camera_from_world = se3.inverse(log.world_from_rig.at(time) @ stream.rig_from_camera)
    corners = boxes.corners(observation.size, camera_from_world @ pose)
    pixels, depth = stream.camera.project(corners)
    for i, j in boxes.EDGES:
        if min(depth[i], depth[j]) > 0.1:
            start, end = (pixels[k].clip(-1e4, 1e4).astype(int).tolist() for k in (i, j))
            cv2.line(image, start, end, _BOX_COLOUR, 2, cv2.LINE_AA)
    return image


def show_actor(folder: Path, out: Path | None = None) -> Path:
    """Draw the sheet of an actor, see `draw_actor_sheet`, and return its file.

    Args:
        out: PNG file to write; beside the folder and of its name if None.

    Raises:
        InputError: no actor lies there, `out` is no PNG or exists already, or the disk refuses.
    """
    if out is None:
        place = Path(folder).resolve()
        out = place.with_name(f"{place.name}.png")
    if out.suffix.lower() != ".png":
        raise InputError(out, "`out`", "is not a PNG", "end its name in .png")
    if out.exists():
        raise InputError(out, "`out`", "exists already", "name another file or remove this one")
    sheet = Image.fromarray(draw_actor_sheet(load_actor(folder)))
    with files.atomic_file(out) as partial:
        sheet.save(partial, format="PNG")
    return out


def compare_with_truth(
    scene: StreetScene,
    actor: Actor,
    source: SourceLog,
    config: SceneConfig,
    seed: int,
    out: Path,
    console: Console,
) -> None:
    """Write views and scores into a folder, see `evaluate_oracle_views`, and print the table.

    Args:
        scene: scene with its own model of the track, in whose place `actor` is inserted.
        source: a synthetic log.
        config: settings of the street: cameras and image scale.

    Raises:
        InputError: see `evaluate_oracle_views`; or the log is not synthetic.
    """
    mounts = camera_mounts(source.log, config.cameras or None, config.scale)
    world = source.world
    with ProgressBar("views", console, 1) as progress:
        views = evaluate_oracle_views(
            source.log,
            scene,
            insert(scene, actor),
            Oracle(world),
            actor.track_id,
            mounts,
            out / VIEWS_FOLDER,
            rng=np.random.default_rng(seed),
            exposures={name: world.exposure(name) for name in mounts},
            shares=actor.shares,
            progress=progress,
        )
    console.print(truth_table(views))


@dataclass(frozen=True)
class GenerationRequest:
    """What to generate.

    Attributes:
        steps: sampling steps of both samplers; the checkpoint's where None.
        cfg: guidance strengths of structure and latent; likewise.

    Raises:
        InputError: no crop, views of several vehicles, or two crops of one name.
    """

    crops: tuple[Path, ...]
    views: tuple[Path, ...]
    seed: int
    mode: MultiImageMode
    steps: int | None
    cfg: tuple[float, float] | None
    limits: GenerationLimits

    def __post_init__(self) -> None:
        if not self.crops:
            raise InputError("CROP", "images", "none are given", "name at least one RGBA image")
        if self.views and len(self.crops) > 1:
            raise InputError(
                "`views`",
                f"{len(self.views)} images",
                f"are given with {len(self.crops)} crops, but show one vehicle only",
                "give one crop, and generate the other vehicles in further calls",
            )
        names = [crop.stem for crop in self.crops]
        for name in names:
            if names.count(name) > 1:
                raise InputError(
                    "CROP",
                    name,
                    "is the name of two images",
                    "rename one: it names the output folder",
                )

    def samplers(self, model: ImageTo3D) -> tuple[SamplerSettings, SamplerSettings]:
        """The checkpoint's, of structure and latent, with what was asked for otherwise."""
        structure, latent = self.cfg or (None, None)
        return (
            model.structure_settings.merged(steps=self.steps, cfg_strength=structure),
            model.latent_settings.merged(steps=self.steps, cfg_strength=latent),
        )


def load_model(
    folder: Path, device: str | None, precision: str | None, image_encoder: Path | None
) -> ImageTo3D:
    """Load a model folder.

    Args:
        device: a torch device; CUDA where there is some, if None.
        precision: float16, bfloat16 or float32; the device's usual one if None.

    Raises:
        InputError: no such device, or see `ImageTo3D.load`.
    """
    try:
        if device is not None:
            torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            "`device`", device or "", reason, "name a device of this machine"
        ) from None
    dtype: torch.dtype | None = None if precision is None else getattr(torch, precision)
    return ImageTo3D.load(folder, device=device, torso_dtype=dtype, image_encoder=image_encoder)


def cost_lines(made: Generation) -> list[str]:
    """What was made, and what it cost, for people."""
    times = ", ".join(f"{stage} {seconds:.1f} s" for stage, seconds in made.seconds.items())
    vehicles = [
        f"{len(one.coords)} voxels, {len(one.gaussians)} Gaussians, seed {one.seed}"
        for one in made.vehicles
    ]
    return [*vehicles, f"{times}; peak memory {made.peak_bytes / 2**30:.2f} GiB"]


def generate_actors(
    request: GenerationRequest, model: ImageTo3D, out: Path, console: Console
) -> Generation:
    """Generate, film and write; one crop into `out`, several into folders named by them.

    Each folder holds `vehicle.ply` (native frame), `viewer.ply` (-y up), `turntable.mp4`,
    `condition.png` (what the image encoder saw) and `generation.json`; `cost.json` beside them
    tells times and memory.

    Raises:
        InputError: an unusable crop, a structure that failed, or `out` exists.
    """
    pictures = [[read_crop(path) for path in (crop, *request.views)] for crop in request.crops]
    structure, latent = request.samplers(model)
    with files.atomic_folder(out) as folder:
        with SamplingProgress(console) as progress:
            made = generate(
                model,
                pictures,
                [request.seed] * len(pictures),
                names=[str(crop) for crop in request.crops],
                mode=request.mode,
                structure=structure,
                latent=latent,
                limits=request.limits,
                progress=progress,
            )
        for crop, views, vehicle in zip(request.crops, pictures, made.vehicles, strict=True):
            target = folder if len(pictures) == 1 else folder / crop.stem
            target.mkdir(exist_ok=True)
            seen = [crop_to_object(view, model.encoder.image_size) for view in views]
            Image.fromarray(np.hstack(seen)).save(target / "condition.png")
            _write_vehicle(target, vehicle, model.low_pass)
            files.write_json(target / "generation.json", _record(request, model, crop, vehicle))
        files.write_json(
            folder / "cost.json", {"seconds": dict(made.seconds), "peak_bytes": made.peak_bytes}
        )
    return made


def _write_vehicle(folder: Path, vehicle: GeneratedVehicle, low_pass: LowPass) -> None:
    write_ply(folder / "vehicle.ply", vehicle.gaussians, low_pass)
    write_ply(folder / "viewer.ply", viewer_frame(vehicle.gaussians), low_pass)
    (width, height), made = _TURNTABLE_SIZE, vehicle.gaussians
    frames = orbit(
        made,
        _extents(made),
        views=_TURNTABLE_VIEWS,
        width=width,
        height=height,
        low_pass=low_pass,
    )
    write_video(folder / TURNTABLE_FILE, frames, fps=_TURNTABLE_VIEWS / 6)


def _extents(gaussians: Gaussians) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(3,) twice how far the visible centres reach from the origin along each axis."""
    seen = gaussians.means[torch.sigmoid(gaussians.logit_opacities) > 0.1]
    if len(seen) == 0:
        seen = gaussians.means
    reach = torch.quantile(seen.abs()[:: max(len(seen) // 100_000, 1)], 0.995, dim=0)
    return 2 * reach.clamp(min=0.05).double().cpu().numpy()


def _record(
    request: GenerationRequest, model: ImageTo3D, crop: Path, vehicle: GeneratedVehicle
) -> dict[str, Any]:
    folder = model.checkpoint.folder
    assert folder is not None  # it was loaded from one
    structure, latent = request.samplers(model)
    return {
        "model": folder.resolve().name,
        "crop": crop.name,
        "views": [view.name for view in request.views],
        "multi_image": request.mode,
        "seed": vehicle.seed,
        "seed_asked_for": request.seed,
        "structure": structure.model_dump(mode="json"),
        "latent": latent.model_dump(mode="json"),
        "voxels": len(vehicle.coords),
        "gaussians": len(vehicle.gaussians),
    }
