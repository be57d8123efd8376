"""Scenes that HUGSIM has published: a folder with scene.pth and a pair of files for each actor.

Source: Zhou et al., "HUGSIM: A Real-Time, Photo-Realistic and Closed-Loop Simulator for Autonomous
Driving" (2024), and the folder that its exporter writes. Its axes are those of a camera: x right, y
down, z forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import require_new
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, Trajectory
from recast.scene.actor import SceneActor
from recast.scene.imported import (
    ImportRecord,
    ScenePlacement,
    given_placement,
    write_imported,
)
from recast.scene.sky import SkyMap
from recast.scene.street_scene import StreetScene
from recast.splats import concatenate
from recast_bridges.scenes.actors import (
    SUSPICIOUS_M,
    TURNING,
    as_tracks,
    check_names,
    check_share,
    colours_in_own_frame,
    extent,
    find_tracks,
    read_track_names,
)
from recast_bridges.scenes.hugsim_actors import (
    Clock,
    actor_names,
    origin_of,
    own_axes,
    read_motion,
    turned,
)
from recast_bridges.scenes.hugsim_files import (
    read_camera_poses,
    read_ground,
    read_hugsim_gaussians,
    read_members,
)


def import_hugsim(
    path: str | Path,
    log: DrivingLog,
    out: str | Path,
    *,
    camera: str | None = None,
    first_frame: int = 0,
    time_unit: float = 1.0,
    world_from_scene: Path | None = None,
    tracks: Path | None = None,
    leave_out: Sequence[str] = (),
    share: float = 0.5,
) -> ImportRecord:
    """Make a scene of a HUGSIM folder: background with ground and sky, rigid actors.

    Args:
        path: the folder.
        log: log of the drive that the scene was trained on.
        camera: the log's camera of which HUGSIM recorded the places; the one that looks forward
            most if None.
        first_frame: its frame at which the scene begins.
        time_unit: seconds of one unit of the scene's times.
        world_from_scene: text file with the scene's place in the log's world.
        tracks: JSON file with the log's track ids by the actors' names.
        leave_out: names of actors not wanted.
        share: share of an actor's time in the scene, in [0, 1], at which its view-dependent colour
            is kept.

    Raises:
        InputError: a file is missing, broken or of another layout, the log lacks the camera or the
            frame, `out` exists. Nothing is written then.
    """
    check_share(share)
    require_new(out)
    folder = Path(path)
    table, step = read_members(folder / "scene.pth")
    background = read_hugsim_gaussians(table)
    ground = read_ground(table)
    if ground is not None:
        background = concatenate([background, read_hugsim_gaussians(ground, flat=True)])
    if len(background) == 0:
        raise table.fault("xyz", "has no Gaussians")
    poses, _ = read_camera_poses(folder / "ground_param.pkl")
    stream = forward_camera(log, camera)
    start_us = start_time(log, stream, first_frame)
    placement, warnings = _placement(log, stream, start_us, poses, world_from_scene)
    names = actor_names(folder)
    given = read_track_names(tracks)
    check_names(table, names, given, leave_out)
    left_out = [f"actor {name}: left out as requested" for name in leave_out]
    clock = Clock(start_us, origin_of(folder, poses[0]), time_unit)
    motions: dict[str, Trajectory] = {}
    for name in (name for name in names if name not in leave_out):
        motion = read_motion(folder, name, clock, placement.world_from_scene)
        if motion is None:
            left_out.append(f"actor {name}: has no unicycle_{name}.pth, which says where it is")
        else:
            motions[name] = motion
    chosen, told = find_tracks(table, log, motions, given, by_name=False)
    found, guessed = {}, []
    for name, motion in motions.items():
        gaussians = read_hugsim_gaussians(read_members(folder / f"dynamic_{name}.pth")[0])
        if len(gaussians) == 0:
            left_out.append(f"actor {name}: has no Gaussians")
            continue
        track = log.tracks.get(chosen.get(name, ""))
        axes = own_axes(motion, None if track is None else track.trajectory)
        if axes is None:
            guessed.append(name)
        trajectory, gaussians = turned(motion, gaussians, axes)
        own_colours = colours_in_own_frame(gaussians, trajectory, placement.world_from_scene, share)
        found[name] = SceneActor(name, own_colours, extent(own_colours.means), trajectory)
    actors, keeping = as_tracks(table, log, found, chosen)
    changed = [TURNING] if found else []
    if guessed:
        changed.append(
            f"{', '.join(guessed)}: hardly move, so their axes are taken to be x right, y forward, "
            "z up"
        )
    left_out.append("feats3D: semantics")
    appearance = table.raw("appearance")
    if isinstance(appearance, dict) and len(appearance) > 0:
        left_out.append("appearance: affine colours of single images, so colours may be shifted")
    pose = torch.from_numpy(placement.world_from_scene)
    return write_imported(
        folder / "scene.pth",
        log,
        out,
        placement,
        StreetScene(background.transformed(pose), actors, SkyMap.constant(torch.zeros(3))),
        layout="hugsim",
        tracks={name: chosen[name] for name in found if name in chosen},
        changed=[*changed, *keeping],
        left_out=left_out,
        warnings=[*warnings, *told],
        iteration=step,
    )


def forward_camera(log: DrivingLog, name: str | None) -> CameraStream:
    """The named camera of the log, or the one that looks forward most.

    Raises:
        InputError: the log has no such camera.
    """
    cameras = log.cameras
    if name is None:
        ahead = {key: one.rig_from_camera[0, 2] for key, one in cameras.items()}
        name = max(ahead, key=lambda key: ahead[key], default="")
    if name not in cameras:
        listed = ", ".join(sorted(cameras)) or "none, the log has no cameras"
        problem = "is not a camera of the log"
        raise InputError(log.name, f"camera {name!r}", problem, f"name one of {listed}")
    return cameras[name]


def start_time(log: DrivingLog, stream: CameraStream, first_frame: int) -> int:
    """Time in microseconds of a camera's frame; of the log's first pose if it has no images.

    Raises:
        InputError: the camera has no such frame.
    """
    count = len(stream.timestamps_us)
    if count == 0 and first_frame == 0:
        return int(log.world_from_rig.timestamps_us[0])
    if not 0 <= first_frame < count:
        problem = f"{stream.name} has frames 0 to {count - 1}"
        raise InputError(log.name, f"frame {first_frame}", problem, "choose another frame")
    return int(stream.timestamps_us[first_frame])


def _placement(
    log: DrivingLog, stream: CameraStream, start_us: int, poses: Array, given: Path | None
) -> tuple[ScenePlacement, list[str]]:
    """Where the scene lies in the log, and what looks wrong with it.

    Args:
        poses: (F, 4, 4) poses of the recorded camera in the scene.
    """
    if given is not None:
        placement = given_placement(given)
    else:
        world_from_camera = log.world_from_rig.at(start_us) @ stream.rig_from_camera
        pose = world_from_camera @ se3.inverse(poses[0])
        placement = ScenePlacement(pose, f"the pose of {stream.name} at {start_us} us")
    path = (log.world_from_rig.poses @ stream.rig_from_camera)[:, :3, 3]
    places = (placement.world_from_scene @ poses)[:, :3, 3]
    distance = float(np.median(distances_to_path(places, path)))
    how = f"{placement.how}; its camera is {distance:.2f} m beside the log's (median)"
    far = f"the camera of the scene is {distance:.2f} m beside the path of {stream.name}"
    return replace(placement, how=how), [far] if distance > SUSPICIOUS_M else []


def distances_to_path(places: Array, path: Array) -> Array:
    """Distances (F,) in metres of places (F, 3) from a path of corners (P, 3)."""
    if len(path) < 2:
        return np.linalg.norm(places - path[0], axis=1)
    start, step = path[:-1], np.diff(path, axis=0)
    length = np.maximum((step**2).sum(axis=1), 1e-12)
    nearest = []
    for place in places:
        share = np.clip(((place - start) * step).sum(axis=1) / length, 0, 1)
        nearest.append(np.linalg.norm(start + share[:, None] * step - place, axis=1).min())
    return np.array(nearest)
