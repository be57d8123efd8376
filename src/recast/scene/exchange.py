"""Scenes of and for other programs: their place in a log, records of imports, exported files.

Importers of checkpoints end in `write_imported`.
"""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recast.arrays import Array, Int64Array
from recast.core.errors import InputError
from recast.core.files import atomic_folder, folder_name, read_text, require_new, write_json
from recast.core.records import Record
from recast.geometry import se3
from recast.logs import DrivingLog, read_log, write_log
from recast.logs.checks import WORLD_REACH
from recast.scene.actor import SceneActor
from recast.scene.sky import SkyMap, read_sky, write_sky
from recast.scene.store import log_fingerprint, save_scene
from recast.scene.street_scene import StreetScene
from recast.splats import CLASSIC, Gaussians
from recast.splats.formats import format_named, format_of, read_gaussians, write_gaussians

TEXT_LIMIT = 1 << 16
"""Bytes of a file of a few numbers, at most."""
IMPORT_VERSION = 1
IMPORT_FILE = "import.json"
MATCHED_SHARE = 0.5
"""With fewer ego positions within the background's bounds the frames are taken to differ."""


@dataclass(frozen=True)
class ScenePlacement:
    """Scene coordinates to the log's world.

    Attributes:
        world_from_scene: (4, 4) rigid.
        how: origin of the placement, one sentence for people.
        scale: factor applied to scene coordinates first.
    """

    world_from_scene: Array
    how: str
    scale: float = 1.0


def read_transform(path: Path) -> Array:
    """A 4x4 matrix (16 numbers, row by row) or a translation (3 numbers): (4, 4).

    Commas and brackets may stand between the numbers.

    Raises:
        InputError: it is missing, holds something else, or has another number of numbers.
    """
    mend = "write 3 or 16 numbers"
    words = re.sub(r"[\[\],;]", " ", read_text(path, TEXT_LIMIT)).split()
    try:
        numbers = np.array(words, np.float64)
    except ValueError as error:
        raise InputError(path, "numbers", f"cannot be read ({error})", mend) from None
    if len(numbers) not in (3, 16) or not np.all(np.abs(numbers) <= WORLD_REACH):  # also NaN
        problem = f"{len(numbers)}, or not all within {WORLD_REACH:g}"
        raise InputError(path, "numbers", problem, mend)
    if len(numbers) == 3:
        return se3.from_rotation_translation(np.eye(3), numbers)
    return numbers.reshape(4, 4)


def given_placement(path: Path, scalable: bool = False) -> ScenePlacement:
    """The placement that a file tells.

    Args:
        scalable: whether the matrix may scale, by one factor for all axes.

    Raises:
        InputError: see `read_transform`; or the matrix shears, mirrors or scales.
    """
    matrix = read_transform(path)
    block = matrix[:3, :3]
    determinant = float(np.linalg.det(block))
    scale = abs(determinant) ** (1 / 3)
    unit = block / scale if determinant > 0 else np.zeros((3, 3))
    rotates = np.allclose(unit @ unit.T, np.eye(3), 0, 1e-4)
    if not rotates or not np.allclose(matrix[3], (0, 0, 0, 1)):
        kind = "a rotation, translation and scale" if scalable else "a rotation and translation"
        raise InputError(path, "matrix", f"is not {kind}", "write another matrix")
    if not scalable and abs(scale - 1) > 1e-4:
        raise InputError(path, "matrix", f"scales by {scale:.6g}", "write a matrix in metres")
    rigid = se3.from_rotation_translation(se3.nearest_rotations(block)[0], matrix[:3, 3])
    return ScenePlacement(rigid, f"as given in {path.name}", scale if scalable else 1.0)


def frame_times(log: DrivingLog, clock: str | None, first: int = 0) -> Int64Array:
    """Times of the log's frames from `first` on: those of one of its sensors.

    Args:
        clock: a camera or LiDAR; where none is named, the LiDAR with most sweeps, else the camera
            with most images.

    Raises:
        InputError: the log has no such sensor, or no frame `first`.
    """
    lidars = {name: lidar.timestamps_us for name, lidar in log.lidars.items()}
    cameras = {name: camera.timestamps_us for name, camera in log.cameras.items()}
    sensors = {**lidars, **cameras}
    if clock is None:
        clock = max(lidars or cameras, key=lambda name: len(sensors[name]), default="")
    if clock not in sensors:
        raise InputError(
            log.name,
            f"clock {clock!r}",
            "is not a sensor of the log",
            f"name one of {', '.join(sorted(sensors)) or 'none, there are no sensors'}",
        )
    times = sensors[clock]
    if not 0 <= first < len(times):
        raise InputError(
            log.name,
            f"frame {first}",
            f"{clock} has frames 0 to {len(times) - 1}",
            "choose another frame",
        )
    return times[first:]


def drive_inside(log: DrivingLog, background: Gaussians) -> float:
    """Share of the recorded ego positions within the bounds of the background, seen from above.

    Bounds are the 1st and 99th percentile of the centres. Far less than 1 means that scene and log
    do not lie in the same frame.
    """
    low, high = np.quantile(background.means[:, :2].numpy(), (0.01, 0.99), axis=0)
    positions = log.world_from_rig.poses[:, :2, 3]
    return float(np.all((positions >= low) & (positions <= high), axis=1).mean())


class ImportRecord(Record):
    """Contents of import.json.

    Attributes:
        layout: layout of the file: street-gaussians, drivestudio, mtgs, hugsim, ply, gltf, spz or
            usd.
        file, sha256: what was imported.
        iteration: training step of a checkpoint.
        log_name, log_fingerprint: the log it was placed in.
        world_from_scene: 4x4, row by row; scene coordinates are scaled by `scale` first.
        placed_by: origin of this transform.
        drive_inside: share of the ego positions within the background's bounds.
        tracks: track of the log by name in the file.
        changed: what was carried over in another form, one sentence each.
        left_out: what was not carried over, one sentence each.
        warnings: what looks wrong.
    """

    version: int = IMPORT_VERSION
    layout: str
    file: str
    sha256: str
    iteration: int | None
    log_name: str
    log_fingerprint: str
    world_from_scene: list[list[float]]
    scale: float
    placed_by: str
    drive_inside: float
    tracks: dict[str, str]
    changed: list[str]
    left_out: list[str]
    warnings: list[str]


def import_with_log(
    log: DrivingLog, own_log: str | Path, make: Callable[[DrivingLog], ImportRecord]
) -> ImportRecord:
    """Write a log that was made of a scene's files and import the scene with it; both or neither.

    Args:
        own_log: folder to write the log to.
        make: imports the scene with the log as it was written.

    Raises:
        InputError: `own_log` exists, the disk refuses, or the scene is refused.
    """
    write_log(log, own_log)
    try:
        return make(read_log(own_log))
    except BaseException:
        shutil.rmtree(own_log)
        raise


def write_imported(
    source: Path,
    log: DrivingLog,
    out: str | Path,
    placement: ScenePlacement,
    scene: StreetScene,
    *,
    layout: str,
    tracks: dict[str, str],
    changed: Sequence[str] = (),
    left_out: Sequence[str] = (),
    warnings: Sequence[str] = (),
    iteration: int | None = None,
) -> ImportRecord:
    """Write a scene that was placed in a log with its import.json, whole or not at all.

    Args:
        source: the file that was imported.
        scene: scene in the log's world; it gets the log's name and offset.
        layout, tracks, changed, left_out, warnings, iteration: see `ImportRecord`.

    Raises:
        InputError: `out` exists, the disk refuses, or the placed scene is not valid.
    """
    scene = replace(scene, world_offset=log.world_offset, log_name=log.name)
    try:
        scene.validate()
    except ValueError as error:
        mend = "check the placement and the values of the file"
        raise InputError(source, "scene", str(error), mend) from None
    inside = drive_inside(log, scene.background)
    if inside < MATCHED_SHARE:
        warnings = (
            *warnings,
            f"only {inside:.0%} of the recorded ego positions lie within the background: "
            "scene and log seem to have different frames",
        )
    with source.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    record = ImportRecord(
        layout=layout,
        file=source.name,
        sha256=digest,
        iteration=iteration,
        log_name=log.name,
        log_fingerprint=log_fingerprint(log),
        world_from_scene=np.asarray(placement.world_from_scene).tolist(),
        scale=placement.scale,
        placed_by=placement.how,
        drive_inside=inside,
        tracks=tracks,
        changed=list(changed),
        left_out=list(left_out),
        warnings=list(warnings),
    )
    with atomic_folder(out) as partial:
        write_json(partial / IMPORT_FILE, record.model_dump(mode="json"))
        save_scene(scene, partial)
    return record


def import_gaussians(
    path: str | Path,
    log: DrivingLog,
    out: str | Path,
    world_from_file: Path | None = None,
    sky: Path | None = None,
) -> ImportRecord:
    """Make a scene without actors of a PLY (INRIA layout), glTF, SPZ or OpenUSD file.

    Files whose format has other axes are turned first, see `recast.splats.formats`.

    Args:
        world_from_file: text file with a 4x4 matrix or an offset from the file's coordinates
            (turned: x forward, y left, z up) to the log's world; the matrix may scale. Without it
            they are taken to be the same.
        sky: equirectangular image as `recast scene export` writes it; black without it.

    Raises:
        InputError: a file is missing, broken or of no known format, it is empty, `out` exists.
    """
    path = Path(path)
    require_new(out)
    background = read_gaussians(path, double=True)
    if len(background) == 0:
        raise InputError(path, "Gaussians", "there are none", "export it again")
    placement = ScenePlacement(np.eye(4), "the log's world (no transform was given)")
    if world_from_file is not None:
        placement = given_placement(world_from_file, scalable=True)
        pose = torch.from_numpy(placement.world_from_scene)
        background = background.transformed(pose, placement.scale)
    seen = SkyMap.constant(torch.zeros(3)) if sky is None else read_sky(sky)
    no_sky = "sky: the file has none, and no image of one was given; it is black"
    layout, low_pass = format_of(path).name, format_of(path).low_pass(path)
    return write_imported(
        path,
        log,
        out,
        placement,
        StreetScene(background, {}, seen, low_pass=low_pass or CLASSIC),
        layout=layout,
        tracks={},
        left_out=() if sky else (no_sky,),
    )


EXPORT_VERSION = 1
EXPORT_FORMAT = "recast-scene-export"
RECORD_FILE, SKY_FILE = "scene.json", "sky.png"
BACKGROUND, MERGED = "background", "merged"
CONVENTIONS = {
    "units": "metres; timestamps in microseconds",
    "world": "z up; coordinates of the dataset = coordinates here + world_offset",
    "actor": "origin in the centre of the box, x forward, y left, z up",
    "poses": "world_from_actor, 4x4, row by row: x_world = R x_actor + t",
    "low_pass": "filter that the Gaussians of the background or an actor were made for: px^2 added "
    "to projected covariances, and whether opacity is lowered by as much; shadows: 0.3, no",
    "sky": "equirectangular, infinitely far, behind the Gaussians (rgb + (1 - alpha) sky): top row "
    "zenith, bottom row nadir, columns from azimuth -pi to pi, counter-clockwise from x seen from "
    "above; 16 bits a channel, 65535 = 1",
}


def export_scene(scene: StreetScene, folder: str | Path, splat_format: str = "ply") -> None:
    """Write background.ply, actors/ID.ply (actor frame), sky.png and scene.json with the poses.

    An actor's shadow is shadows/ID.ply, in the actor's frame too, and goes where the actor goes. A
    deformable actor has the shape of the middle of its time.

    Args:
        splat_format: format of the Gaussians' files, whose names end accordingly; each file is
            turned into the axes of the format.

    Raises:
        InputError: `folder` exists, a part does not fit into the format, or the disk is full.
    """
    names, suffix = _file_names(scene.actors), format_named(splat_format).suffix
    with atomic_folder(folder) as partial:
        write_gaussians(partial / f"{BACKGROUND}{suffix}", scene.background, scene.low_pass)
        actors = []
        for track_id, actor in scene.actors.items():
            files = {"gaussians": f"actors/{names[track_id]}{suffix}"}
            shaped = actor.shaped_at(None).gaussians
            write_gaussians(partial / files["gaussians"], shaped, actor.low_pass)
            if actor.shadow is not None:
                files["shadow"] = f"shadows/{names[track_id]}{suffix}"
                write_gaussians(partial / files["shadow"], actor.shadow)
            actors.append(_actor_record(actor) | files)
        parts = {"background": f"{BACKGROUND}{suffix}", "actors": actors}
        _finish(scene, partial, splat_format, parts)


def export_scene_at(
    scene: StreetScene, folder: str | Path, seconds: float, splat_format: str = "ply"
) -> int:
    """Write merged.ply, everything there at a time in the world frame, sky.png and scene.json.

    Args:
        seconds: time after the first time that the scene knows, see `scene_interval`.
        splat_format: see `export_scene`.

    Returns:
        The timestamp in microseconds.

    Raises:
        InputError: the scene knows no times, or not this one; `folder` exists; the disk is full.
    """
    first, last = scene_interval(scene)
    if not 0 <= seconds * 1e6 <= last - first:
        raise InputError(
            "command line",
            "`time`",
            f"{seconds:g} s is not within the scene's times",
            f"give a time from 0 to {(last - first) / 1e6:g}",
        )
    timestamp_us = first + round(seconds * 1e6)
    poses = scene.actor_poses(timestamp_us)
    with atomic_folder(folder) as partial:
        merged = f"{MERGED}{format_named(splat_format).suffix}"
        write_gaussians(partial / merged, scene.at(poses, timestamp_us), scene.low_pass)
        actors = [
            {"track_id": track_id, "world_from_actor": pose.tolist()}
            for track_id, pose in poses.items()
        ]
        parts = {"merged": merged, "timestamp_us": timestamp_us, "actors": actors}
        _finish(scene, partial, splat_format, parts)
    return timestamp_us


def scene_interval(scene: StreetScene) -> tuple[int, int]:
    """First and last time, microseconds, of the actors' poses and the images trained on.

    Raises:
        InputError: the scene knows no times.
    """
    known = [actor.trajectory.timestamps_us for actor in scene.actors.values()]
    known += [times for times, _ in scene.camera_corrections.values()]
    times = np.concatenate([np.zeros(0, np.int64), *known])
    if len(times) == 0:
        raise InputError(
            scene.log_name or "scene",
            "times",
            "the scene has no actors",
            "export it without a time",
        )
    return int(times.min()), int(times.max())


def _actor_record(actor: SceneActor) -> dict[str, Any]:
    return {
        "track_id": actor.track_id,
        "size": np.asarray(actor.size).tolist(),
        "low_pass": asdict(actor.low_pass),
        "timestamps_us": actor.trajectory.timestamps_us.tolist(),
        "world_from_actor": actor.trajectory.poses.tolist(),
    }


def _finish(scene: StreetScene, folder: Path, splat_format: str, parts: dict[str, Any]) -> None:
    write_sky(folder / SKY_FILE, scene.sky)
    record = {
        "format": EXPORT_FORMAT,
        "version": EXPORT_VERSION,
        "log_name": scene.log_name,
        "world_offset": np.asarray(scene.world_offset).tolist(),
        "sky": SKY_FILE,
        "low_pass": asdict(scene.low_pass),
        "splat_format": splat_format,
        **parts,
        "conventions": CONVENTIONS | {"gaussians": format_named(splat_format).contents},
    }
    write_json(folder / RECORD_FILE, record)


def _file_names(track_ids: Iterable[str]) -> dict[str, str]:
    """File names without ending, also different where upper and lower case are the same."""
    names: dict[str, str] = {}
    for track_id in track_ids:
        name = folder_name(track_id)
        while name.lower() in {other.lower() for other in names.values()}:
            name += "_"
        names[track_id] = name
    return names
