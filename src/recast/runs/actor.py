"""The actor of a run: observe the target, generate a vehicle, register it, film and judge it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Self

import cv2
import numpy as np
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
    save_actor,
    segmenter_of,
)
from recast.actors.candidates import choose
from recast.actors.evidence import load_evidence, save_evidence
from recast.actors.gather_evidence import gather_evidence
from recast.actors.generate import candidates_of
from recast.actors.insert import require_model
from recast.actors.refine import refine
from recast.actors.views import Usable
from recast.core import files
from recast.core.errors import InputError
from recast.core.progress import Progress, ProgressBar
from recast.geometry import boxes, se3
from recast.logs import DrivingLog
from recast.metrics import evaluate_oracle_views
from recast.reconstruction import SceneConfig
from recast.reconstruction.views import is_held_out
from recast.reporting.actor_sheet import draw_actor_sheet, turntable_frames
from recast.reporting.video import write_video
from recast.runs.display import truth_table
from recast.runs.layout import (
    ACTOR_FOLDER,
    EVIDENCE_FILE,
    OBSERVATION_FOLDER,
    REFINEMENT_CHECKPOINT,
    VIEWS_FOLDER,
)
from recast.runs.sources import SourceLog
from recast.scene import StreetScene
from recast.simulation import camera_mounts
from recast.synthetic import Oracle
from recast.synthetic.rig import exposure

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
) -> Actor:
    """Observe, gather evidence, generate candidates, register and choose.

    Writes `observation/` with the evidence, and `actor/` below `out`. InputError: see `observe` and
    `choose`.

    Args:
        config: settings of the street's scene: cameras, image scale, and the frames that are held
            out.
        views: largest number of views of the track that a generator is given.
        progress: function that is told the stage, the pieces done, and all pieces of the stage.
    """
    observation = observe(
        log,
        track_id,
        segmenter=makers.segmenter,
        cameras=config.cameras,
        views=views,
        usable=training_frames(config),
    )
    evidence = gather_evidence(
        log,
        track_id,
        segmenter=makers.segmenter,
        config=config,
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
        actor,
        evidence,
        scene,
        seed,
        checkpoint=checkpoint,
        progress=_stage(progress, "refinement"),
    )
    if (out / ACTOR_FOLDER).exists():  # a kill between the folder and the removal below
        shutil.rmtree(out / ACTOR_FOLDER)
    save_actor(refined, out / ACTOR_FOLDER)
    checkpoint.unlink(missing_ok=True)
    return refined


def _stage(progress: StageProgress | None, name: str) -> Progress | None:
    return None if progress is None else partial(progress, name)


def training_frames(config: SceneConfig) -> Usable:
    """The frames that a scene is trained on: those held out must not lead to its actors either."""
    return lambda camera, frame: not is_held_out(frame, config)


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
            exposures={name: exposure(world.seed, name) for name in mounts},
            shares=actor.shares,
            progress=progress,
        )
    console.print(truth_table(views))
