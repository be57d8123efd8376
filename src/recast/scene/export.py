"""Scenes for other programs: one file a part, or all that is there at a time in one file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from recast.core.errors import InputError
from recast.core.files import atomic_folder, write_json
from recast.core.names import folder_name
from recast.scene.actor import SceneActor
from recast.scene.sky import write_sky
from recast.scene.street_scene import StreetScene
from recast.splats.formats import format_named, write_gaussians

EXPORT_VERSION = 1
EXPORT_FORMAT = "recast-scene-export"
RECORD_FILE, SKY_FILE = "scene.json", "sky.png"
BACKGROUND, MERGED = "background", "merged"
CONVENTIONS = {
    "units": "metres; timestamps in microseconds",
    "world": "z up; coordinates of the dataset = coordinates here + world_offset",
    "actor": "origin in the centre of the box, x forward, y left, z up",
    "poses": "world_from_actor, 4x4, row by row: x_world = R x_actor + t",
    "low_pass": "filter that an actor's Gaussians were made for: px^2 added to projected "
    "covariances, and whether opacity is lowered by as much; everything else: 0.3, not lowered",
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
        write_gaussians(partial / f"{BACKGROUND}{suffix}", scene.background)
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
        write_gaussians(partial / merged, scene.at(poses, timestamp_us))
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
