"""The actor of a run: observe the target, generate a vehicle, register it, film it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from recast import storage
from recast.actors import (
    AUTO,
    Actor,
    ActorGenerator,
    Observation,
    PlyGenerator,
    Segmenter,
    axes_of,
    make_generator,
    observe,
    register,
    save_actor,
    segmenter_of,
    turntable,
)
from recast.actors.axes import UNIT_CUBE_Z_UP
from recast.actors.view_pool import Usable
from recast.errors import InputError
from recast.geometry import boxes, se3
from recast.logs import DrivingLog
from recast.pipeline.layout import ACTOR_FOLDER, OBSERVATION_FOLDER, TURNTABLE_FILE
from recast.reporting.video import write_video
from recast.scene import SceneConfig
from recast.scene.views import is_held_out

_TURNTABLE_VIEWS = 72
_TURNTABLE_SIZE = (640, 360)
_BOX_COLOUR = (255, 170, 0)


def generator_of(name: str, axes: str = AUTO) -> ActorGenerator:
    """A generator by its name, or one for the PLY file or the model folder of that path.

    Args:
        axes: orientation of a PLY or a model, see `recast.actors.axes_of`. With "auto", that of a
            PLY is told from its shape, and models are z up with any heading.

    Raises:
        InputError: no such generator, no such file, no such axes, or axes of a generator that knows
            its own; or a model that cannot be loaded.
    """
    if name.lower().endswith(".ply"):
        path = Path(name)
        if not path.is_file():
            raise InputError(path, "file", "is missing", "check the path given as --generator")
        return PlyGenerator(path, axes)
    if Path(name).is_dir():
        from recast.actors.image_to_3d_generator import ImageTo3DGenerator

        return ImageTo3DGenerator(name, axes=UNIT_CUBE_Z_UP if axes == AUTO else axes_of(axes))
    if axes != AUTO:
        raise InputError(
            "--axes", axes, f"is not for the generator {name}, which knows its axes", "leave it out"
        )
    return make_generator(name)


@dataclass(frozen=True)
class ActorMakers:
    """What cuts a vehicle out and what generates it, their networks in memory."""

    generator: ActorGenerator
    segmenter: Segmenter

    @classmethod
    def named(cls, generator: str, segmenter: str, axes: str = AUTO) -> Self:
        """Those of these names, see `generator_of` and `segmenter_of`.

        Raises:
            InputError: there is none of a name, or it cannot be loaded.
        """
        return cls(generator_of(generator, axes), segmenter_of(segmenter))


def make_actor(
    log: DrivingLog,
    track_id: str,
    makers: ActorMakers,
    seed: int,
    out: Path,
    cameras: tuple[str, ...] = (),
    views: int = 1,
    usable: Usable | None = None,
) -> Actor:
    """Observe, generate, register; write `observation/`, `actor/` and `turntable.mp4` below `out`.

    Args:
        cameras: observe from these only; from all where none is named.
        views: of the track to use at most.
        usable: which frames may be looked at; all if None. See `training_frames`.

    Raises:
        InputError: see `observe` and `register`.
    """
    observation = observe(
        log, track_id, segmenter=makers.segmenter, cameras=cameras, views=views, usable=usable
    )
    with storage.atomic_folder(out / OBSERVATION_FOLDER) as folder:
        save_observation(observation, log, folder)
    asset = makers.generator.generate(observation, seed)
    actor = register(asset, observation, log, log.tracks[track_id])
    save_actor(actor, out / ACTOR_FOLDER)
    film_turntable(actor, out / TURNTABLE_FILE)
    return actor


def training_frames(config: SceneConfig) -> Usable:
    """The frames that a scene is trained on: those held out must not lead to its actors either."""
    return lambda camera, frame: not is_held_out(frame, config)


def film_turntable(actor: Actor, path: Path) -> None:
    """Write a film of an actor turning once in six seconds."""
    width, height = _TURNTABLE_SIZE
    frames = turntable(actor, views=_TURNTABLE_VIEWS, width=width, height=height)
    write_video(path, frames, fps=_TURNTABLE_VIEWS / 6)


def save_observation(observation: Observation, log: DrivingLog, folder: Path) -> None:
    """Write each crop, the frame it was cut from with the box drawn in, and why these views."""
    for number, view in enumerate(observation.views, 1):
        mark = "" if number == 1 else f"_{number}"
        Image.fromarray(view.rgba, "RGBA").save(folder / f"crop{mark}.png")
        Image.fromarray(_frame_with_box(view, log)).save(folder / f"frame{mark}.png")
    storage.write_text(folder / "explanation.txt", observation.explain() + "\n")


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
