"""Streets of HUGSIM: their actors (times, places, own axes), their import, and a log of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import require_new
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, Track, Trajectory
from recast.logs.checks import LATEST_US, refused
from recast.scene.actor import SceneActor
from recast.scene.exchange import (
    ImportRecord,
    ScenePlacement,
    given_placement,
    import_with_log,
    write_imported,
)
from recast.scene.sky import SkyMap
from recast.scene.street_scene import StreetScene
from recast.splats import Gaussians, concatenate
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
from recast_bridges.scenes.hugsim_files import (
    NAMES,
    Recording,
    front_camera,
    read_camera_poses,
    read_ground,
    read_hugsim_gaussians,
    read_members,
    read_recordings,
    read_unicycle,
)

RECORDINGS_FILE = "meta_data.json"
MOVED_M = 1.0
"""An actor that goes farther than this shows which of its axes points forward."""
UPRIGHT = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
"""Own axes of an actor whose motion does not show them: x right, y forward, z up."""
_ACTOR = re.compile(r"dynamic_([A-Za-z0-9-]{1,64})\.pth")


@dataclass(frozen=True)
class Clock:
    """How the scene's times lie in the log."""

    start_us: int  # time of the log, microseconds, ..
    origin: float  # ... that is this time of the scene.
    unit: float  # seconds of one unit of the scene's times

    def __post_init__(self) -> None:
        """Refuse a unit that is no time; InputError names the option."""
        if not 1e-6 <= self.unit <= 1e3:
            raise InputError("command line", "`time_unit`", f"is {self.unit:g}", "give seconds")

    def times_us(self, times: Array) -> Array:
        """Microseconds of the log, whole and as float64, of the scene's times."""
        return self.start_us + np.round((times - self.origin) * self.unit * 1e6)


def actor_names(folder: Path) -> list[str]:
    """Names of the actors that have Gaussians, sorted."""
    found = (_ACTOR.fullmatch(one.name) for one in folder.glob("dynamic_*.pth"))
    return sorted(one[1] for one in found if one is not None)


def origin_of(folder: Path, pose: Array) -> float:
    """The scene's time of the image that was taken at a camera pose (4, 4); 0 without
    meta_data.json. Raises InputError: see `read_recordings`."""
    if not (folder / RECORDINGS_FILE).exists():
        return 0.0
    recordings = read_recordings(folder / RECORDINGS_FILE)
    name, index = front_camera(recordings, pose)
    return float(recordings[name].times[index])


def read_motion(
    folder: Path, name: str, clock: Clock, world_from_scene: Array
) -> Trajectory | None:
    """`world_from_own` of an actor; None without its file. Raises InputError: the file is broken,
    or its times are none of a log."""
    file = folder / f"unicycle_{name}.pth"
    if not file.exists():
        return None
    times, poses = read_unicycle(file)
    times_us = clock.times_us(times)
    if not np.all((times_us >= 0) & (times_us < LATEST_US)) or np.any(np.diff(times_us) <= 0):
        problem = "are not times of the log that increase"
        raise InputError(file, "train_timestamp", problem, "check the unit (`time_unit`)")
    return Trajectory(times_us.astype(np.int64), world_from_scene @ poses)


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


def turned(
    motion: Trajectory, gaussians: Gaussians, axes: Array | None
) -> tuple[Trajectory, Gaussians]:
    """Poses and Gaussians of an actor with axes forward, left, up; harmonics stay in scene axes.

    Args:
        axes: see `own_axes`; `UPRIGHT` if None.
    """
    turn = se3.from_rotation_translation(UPRIGHT if axes is None else axes, np.zeros(3))
    poses = motion.poses @ se3.inverse(turn)
    moved = gaussians.transformed(torch.from_numpy(turn))
    return Trajectory(motion.timestamps_us, poses), replace(moved, sh=gaussians.sh)


# Scenes that HUGSIM has published: a folder with scene.pth and a pair of files for each actor.
#
# Source: Zhou et al., "HUGSIM: A Real-Time, Photo-Realistic and Closed-Loop Simulator for
# Autonomous Driving" (2024), and the folder that its exporter writes. Its axes are those of a
# camera: x right, y down, z forward.


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
    """The named camera of the log, or the one that looks forward most. Raises InputError: the log
    has no such camera."""
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
    """Time in microseconds of a camera's frame; of the log's first pose if it has no images. Raises
    InputError: the camera has no such frame."""
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


# The log of a HUGSIM street, made of the street's own files, where its dataset is not at hand.
#
# It has what the files tell: the camera's way, cameras, and the actors as tracks. It has no images,
# no LiDAR and no map.

RIG_FROM_CAMERA = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""Axes forward, left, up of a camera's right, down, forward."""
_MEND = "give the log that was imported from the dataset (`log`)"


def import_hugsim_with_log(
    path: str | Path,
    own_log: str | Path,
    out: str | Path,
    *,
    time_unit: float = 1.0,
    **options: Any,
) -> ImportRecord:
    """Write the log of a street's own files, and the street as a scene of it.

    Args:
        path: the scene's folder.
        own_log: folder to write the log to.
        time_unit: seconds of one unit of the scene's times.
        options: see `import_hugsim`.

    Raises:
        InputError: see `hugsim_log` and `import_hugsim`. Nothing is written then.
    """
    require_new(out)
    return import_with_log(
        hugsim_log(path, time_unit),
        own_log,
        lambda log: import_hugsim(path, log, out, time_unit=time_unit, **options),
    )


def hugsim_log(path: str | Path, time_unit: float = 1.0) -> DrivingLog:
    """The log of a street. Its rig is the ground below the front camera.

    Args:
        time_unit: seconds of one unit of the scene's times.

    Raises:
        InputError: a file is missing, broken or of another layout, or the front camera has fewer
            than two images.
    """
    folder = Path(path)
    poses, height = read_camera_poses(folder / "ground_param.pkl")
    recordings = read_recordings(folder / RECORDINGS_FILE)
    name, first = front_camera(recordings, poses[0])
    front = recordings[name]
    times = front.times[first:]
    if len(times) < 2:
        problem = "has fewer than two images from the scene's first one on"
        raise InputError(folder / RECORDINGS_FILE, f"camera {name}", problem, _MEND)
    clock = Clock(0, float(times[0]), time_unit)
    rig_from_camera = se3.from_rotation_translation(RIG_FROM_CAMERA, [0, 0, height])
    world_from_scene = rig_from_camera @ se3.inverse(front.poses[first])
    ego = Trajectory(
        clock.times_us(times).astype(np.int64),
        world_from_scene @ front.poses[first:] @ se3.inverse(rig_from_camera),
    )
    log = DrivingLog(
        name=folder.resolve().name,
        cameras={},
        lidars={},
        world_from_rig=ego,
        tracks={},
        metadata={"dataset": "HUGSIM", "licence": "that of the dataset", "images": "none"},
    )
    with refused(folder / RECORDINGS_FILE, _MEND):
        log.validate()
    cameras = {}
    for key, one in recordings.items():
        mount = rig_from_camera if key == name else _mount(one, ego, clock, world_from_scene)
        if mount is not None:
            cameras[key] = CameraStream(key, one.camera, mount, np.zeros(0, np.int64), [])
    log = replace(log, cameras=cameras, tracks=_tracks(folder, ego, clock, world_from_scene))
    with refused(folder, _MEND):
        log.validate()
    return log


def _mount(
    recording: Recording, ego: Trajectory, clock: Clock, world_from_scene: Array
) -> Array | None:
    """`rig_from_camera` of the first image that was taken on the ego's way."""
    times_us = clock.times_us(recording.times)
    there = np.flatnonzero((times_us >= ego.timestamps_us[0]) & (times_us <= ego.timestamps_us[-1]))
    if len(there) == 0:
        return None
    world_from_rig = ego.at(int(times_us[there[0]]))
    mount: Array = se3.inverse(world_from_rig) @ world_from_scene @ recording.poses[there[0]]
    return mount


def _tracks(
    folder: Path, ego: Trajectory, clock: Clock, world_from_scene: Array
) -> dict[str, Track]:
    """The actors that are there in the log's time, as cars of the size of their shape."""
    first, last = ego.timestamps_us[[0, -1]]
    tracks = {}
    for name in actor_names(folder):
        motion = read_motion(folder, name, clock, world_from_scene)
        if motion is None:
            continue
        there = (motion.timestamps_us >= first) & (motion.timestamps_us <= last)
        table, _ = read_members(folder / f"dynamic_{name}.pth")
        means = table.tensor(NAMES.means, None, 3)
        if not there.any() or len(means) == 0:
            continue
        found = own_axes(motion, None)
        axes = UPRIGHT if found is None else found
        turn = se3.from_rotation_translation(axes, np.zeros(3))
        own = Trajectory(motion.timestamps_us[there], motion.poses[there] @ se3.inverse(turn))
        size = extent(means @ torch.from_numpy(axes).float().T)
        tracks[name] = Track(name, "car", size, own)
    return tracks
