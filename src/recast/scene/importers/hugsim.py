"""Scenes that HUGSIM has published: a folder with scene.pth and a pair of files for each actor.

Source: Zhou et al., "HUGSIM: A Real-Time, Photo-Realistic and Closed-Loop Simulator for Autonomous
Driving" (2024), and the folder that its exporter writes. Its axes are those of a camera: x right, y
down, z forward.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations, product
from pathlib import Path

import numpy as np
import torch

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import require_new
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, Trajectory
from recast.scene.importers.actors import (
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
from recast.scene.importers.hugsim_files import (
    first_time,
    read_camera_poses,
    read_ground,
    read_hugsim_gaussians,
    read_members,
    read_unicycle,
)
from recast.scene.importers.placement import (
    ImportRecord,
    Placement,
    given_placement,
    write_imported,
)
from recast.scene.sky import SkyMap
from recast.scene.street_scene import SceneActor, StreetScene
from recast.splats import Gaussians, concatenate

ACTOR = re.compile(r"dynamic_([A-Za-z0-9-]{1,64})\.pth")
MOVED_M = 1.0
"""An actor that goes farther than this shows which of its axes points forward."""
_UPRIGHT = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
"""Own axes of an actor whose motion does not show them: x right, y forward, z up."""


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
        log: of the drive it was trained on.
        camera: the log's camera of which HUGSIM recorded the places; the one that looks forward
            most if None.
        first_frame: its frame at which the scene begins.
        time_unit: seconds of one unit of the scene's times.
        world_from_scene: text file with the scene's place in the log's world.
        tracks: JSON file with the log's track ids by the actors' names.
        leave_out: names of actors not wanted.
        share: in [0, 1], of an actor's time in the scene: where its view-dependent colour is kept.

    Raises:
        InputError: a file is missing, broken or of another layout, the log lacks the camera or the
            frame, `out` exists. Nothing is written then.
    """
    check_share(share)
    if not 1e-6 <= time_unit <= 1e3:
        raise InputError("command line", "`time_unit`", f"is {time_unit:g}", "give seconds")
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
    stream = forward_camera(log, camera, first_frame)
    start_us = int(stream.timestamps_us[first_frame])
    placement, warnings = _placement(log, stream, start_us, poses, world_from_scene)
    files = sorted(one for one in folder.glob("dynamic_*.pth") if ACTOR.fullmatch(one.name))
    names = [one.stem.removeprefix("dynamic_") for one in files]
    given = read_track_names(tracks)
    check_names(table, names, given, leave_out)
    origin = first_time(folder / "meta_data.json")
    left_out = [f"actor {name}: asked to be left out" for name in leave_out]
    motions: dict[str, Trajectory] = {}
    for name in (name for name in names if name not in leave_out):
        file = folder / f"unicycle_{name}.pth"
        if not file.exists():
            left_out.append(f"actor {name}: has no {file.name}, which says where it is")
            continue
        times, own = read_unicycle(file)
        times_us = start_us + np.round((times - origin) * time_unit * 1e6)
        if not np.all((times_us >= 0) & (times_us < 2.0**53)) or np.any(np.diff(times_us) <= 0):
            raise InputError(file, "train_timestamp", "are no times of the log", "`time_unit`")
        motions[name] = Trajectory(times_us.astype(np.int64), placement.world_from_scene @ own)
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
            axes = _UPRIGHT
        trajectory, gaussians = _turned(motion, gaussians, axes)
        own_colours = colours_in_own_frame(gaussians, trajectory, placement.world_from_scene, share)
        found[name] = SceneActor(name, own_colours, extent(own_colours), trajectory)
    actors, keeping = as_tracks(table, log, found, chosen)
    changed = [TURNING] if found else []
    if guessed:
        changed.append(
            f"{', '.join(guessed)}: hardly move, so their axes are taken to be x right, y forward, "
            "z up"
        )
    left_out.append("feats3D: semantics")
    if "appearance" in table:
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


def forward_camera(log: DrivingLog, name: str | None, first_frame: int) -> CameraStream:
    """The named camera of the log, or the one that looks forward most.

    Raises:
        InputError: the log has no such camera, or the camera no such frame.
    """
    cameras = log.cameras
    if name is None:
        ahead = {key: one.rig_from_camera[0, 2] for key, one in cameras.items()}
        name = max(ahead, key=lambda key: ahead[key], default="")
    if name not in cameras:
        listed = ", ".join(sorted(cameras)) or "none, the log has no cameras"
        problem = "is no camera of the log"
        raise InputError(log.name, f"camera {name!r}", problem, f"name one of {listed}")
    count = len(cameras[name].timestamps_us)
    if not 0 <= first_frame < count:
        problem = f"{name} has frames 0 to {count - 1}"
        raise InputError(log.name, f"frame {first_frame}", problem, "name another")
    return cameras[name]


def _placement(
    log: DrivingLog, stream: CameraStream, start_us: int, poses: Array, given: Path | None
) -> tuple[Placement, list[str]]:
    """Where the scene lies in the log, and what looks wrong with it.

    Args:
        poses: (F, 4, 4) of the recorded camera in the scene.
    """
    if given is not None:
        placement = given_placement(given)
    else:
        world_from_camera = log.world_from_rig.at(start_us) @ stream.rig_from_camera
        pose = world_from_camera @ se3.inverse(poses[0])
        placement = Placement(pose, f"the pose of {stream.name} at {start_us} us")
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


def own_axes(motion: Trajectory, track: Trajectory | None) -> Array | None:
    """The rotation (3, 3) from an actor's own axes to forward, left and up.

    The layout does not say how an actor's own axes lie. They are along its box, so one of 24
    rotations is nearest to what its track shows, or its way if it moves.

    Returns:
        None if there is no track and the actor hardly moves.
    """
    turns = motion.poses[:, :3, :3]
    if track is not None:
        inside = (motion.timestamps_us >= track.timestamps_us[0]) & (
            motion.timestamps_us <= track.timestamps_us[-1]
        )
        if not inside.any():
            return None
        true = track.at(motion.timestamps_us[inside])[:, :3, :3]
        turns = turns[inside]
    else:
        way = np.diff(motion.poses[:, :2, 3], axis=0)
        lengths = np.linalg.norm(way, axis=1)
        if lengths.sum() < MOVED_M:
            return None
        # The longer a step, the surer is its direction.
        true = se3.rotation_z(np.arctan2(way[:, 1], way[:, 0])) * lengths[:, None, None]
        turns = turns[:-1]
    mean = (true.swapaxes(1, 2) @ turns).sum(axis=0)
    return max(_axis_rotations(), key=lambda rotation: float((rotation * mean).sum()))


def _axis_rotations() -> list[Array]:
    """The 24 rotations that carry axes to axes."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        rotation = np.zeros((3, 3))
        rotation[range(3), order] = signs
        if np.linalg.det(rotation) > 0:
            found.append(rotation)
    return found


def _turned(motion: Trajectory, gaussians: Gaussians, axes: Array) -> tuple[Trajectory, Gaussians]:
    """Poses and Gaussians of an actor with other own axes; harmonics stay in scene axes."""
    turn = se3.from_rotation_translation(axes, np.zeros(3))
    poses = motion.poses @ se3.inverse(turn)
    moved = gaussians.transformed(torch.from_numpy(turn))
    return Trajectory(motion.timestamps_us, poses), replace(moved, sh=gaussians.sh)
