"""Streets of MTGS: their checkpoints, the frames that they were trained on, and a log of them.

`video_scene_dict.pkl` is a pickle, read without running it: a table of drives, each with
`frame_infos`, a list of tables with the time, the ego's pose in the coordinates of the scene,
cameras and boxes. Only what is used is looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recast.arrays import Array, Int64Array
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.files import require_new
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, Track, Trajectory
from recast.logs.checks import LATEST_US, WORLD_REACH, refused
from recast.scene.actor import SceneActor
from recast.scene.exchange import ImportRecord, ScenePlacement, import_with_log, write_imported
from recast.scene.sky import sky_from_cubemap
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
from recast_bridges.scenes.checkpoint import (
    NO_SKY,
    RESAMPLED,
    CheckpointTable,
    read_checkpoint,
    read_pickle,
)
from recast_bridges.scenes.drivestudio import CUBE_FROM_SCENE
from recast_bridges.scenes.mtgs_nodes import (
    CHECKPOINT,
    GROUND,
    MIRRORED,
    NAMES,
    RIGID,
    SCENERY,
    MtgsNode,
    exposed,
    lost,
    read_ego,
    read_environment,
    read_gaussian_node,
    read_motion,
    read_shift,
)

FRAMES_FILE = "video_scene_dict.pkl"
_MEND_FRAMES = "name the checkpoint itself to import it without the recorded frames"


def read_drives(path: Path) -> dict[str, list[CheckpointTable]]:
    """The frames of each recorded drive, by the drive's token. Raises InputError: the file is
    missing, is damaged or holds other things than plain values and arrays; no code in it is run. Or
    a drive has no list of frames."""
    content = read_pickle(path, _MEND_FRAMES)
    if not isinstance(content, Mapping):
        raise InputError(
            path, "pickle", f"holds {type(content).__name__}, not a table", _MEND_FRAMES
        )
    drives = content if "frame_infos" not in content else {"": content}
    found = {}
    for name, drive in drives.items():
        rows = drive.get("frame_infos") if isinstance(drive, Mapping) else None
        if not isinstance(rows, list):
            raise InputError(path, f"drive {name}", "has no list frame_infos", _MEND_FRAMES)
        for index, row in enumerate(rows):
            if not isinstance(row, Mapping):
                raise InputError(
                    path, f"{name}.frame_infos[{index}]", "is not a table", _MEND_FRAMES
                )
        found[str(name)] = [
            CheckpointTable(path, row, f"{name}.frame_infos[{index}]")
            for index, row in enumerate(rows)
        ]
    return found


def read_places(frames: Sequence[CheckpointTable]) -> tuple[Int64Array, Array]:
    """Times (F,) in microseconds and places (F, 3) of the ego in the scene. Raises InputError: a
    frame lacks its time or its place."""
    times, places = [], []
    for frame in frames:
        time = frame.number("timestamp")
        if not 0 <= time < LATEST_US:
            raise frame.fault("timestamp", f"is {time:g}, not microseconds", _MEND_FRAMES)
        name = "ego2global" if "ego2global" in frame else "ego2global_translation"
        place = frame.array(name)
        place = place[:3, 3] if place.shape == (4, 4) else place
        if place.shape != (3,) or not np.all(np.abs(place) <= WORLD_REACH):  # also NaN
            raise frame.fault(name, "is not a pose in metres", _MEND_FRAMES)
        times.append(round(time))
        places.append(place)
    return np.array(times, np.int64), np.array(places, np.float64).reshape(-1, 3)


def distance_to_log(
    times_us: Int64Array, places: Array, world_from_scene: Array, log: DrivingLog
) -> tuple[float, int]:
    """Median distance in metres, seen from above, of the two recordings of the ego's places.

    Args:
        times_us: (F,) times in microseconds.
        places: (F, 3) places of the ego in the scene.

    Returns:
        The distance, 0 if no time is in the log; and the number of frames whose times are.
    """
    first, last = log.world_from_rig.timestamps_us[[0, -1]]
    shared = (times_us >= first) & (times_us <= last)
    if not shared.any():
        return 0.0, 0
    there = se3.apply(world_from_scene, places[shared])
    gaps = there - log.world_from_rig.at(times_us[shared])[:, :3, 3]
    return float(np.median(np.linalg.norm(gaps[:, :2], axis=1))), int(shared.sum())


# Portable checkpoints of MTGS (`NAME/background/NAME.ckpt`), which has published nuPlan scenes.
#
# Source: Li et al., "MTGS: Multi-Traversal Gaussian Splatting" (2025), and the portable layout that
# its trainer exports for renderers.

_SAME_LOG = "give the log of the same drive; see docs/howto/published_streets.md"


def import_mtgs(
    path: str | Path,
    log: DrivingLog,
    out: str | Path,
    *,
    tracks: Path | None = None,
    leave_out: Sequence[str] = (),
    share: float = 0.5,
) -> ImportRecord:
    """Make a scene of a portable MTGS checkpoint: scenery, sky, rigid and mirrored actors.

    Odyssey's sheets of ground and its cubemap of the sky are read as well.

    Args:
        path: the scene's folder, or its checkpoint. Only of a folder the recorded frames
            (video_scene_dict.pkl) are compared with the log's.
            An Odyssey scene (scene.ckpt) has the ego's places in the checkpoint.
        log: log of the drive that the scene was trained on.
        tracks: JSON file with the log's track ids by the actors' tokens.
        leave_out: tokens of actors not wanted.
        share: share of an actor's time in the scene, in [0, 1], at which its changing colour is
            frozen.

    Raises:
        InputError: a file is missing, broken or of another layout, no actor is there in the log's
            time, `out` exists. Nothing is written then.
    """
    check_share(share)
    require_new(out)
    folder, file = find_checkpoint(Path(path))
    root = read_checkpoint(file, arrays=True)
    nodes, left_out = read_nodes(root, leave_out)
    names = [name for name, node in nodes.items() if node.kind not in SCENERY]
    given = read_track_names(tracks)
    check_names(root, [*names, *leave_out], given, ())
    placement, warnings = _placement(root, log, folder)
    scenery = [read_gaussian_node(node, share) for node in nodes.values() if node.kind in SCENERY]
    if "background" not in nodes or "background" in names or len(scenery[0]) == 0:
        raise root.fault("background", "is missing, no scenery, or has no Gaussians")
    found: dict[str, SceneActor] = {}
    waves, gaps, elsewhere, moving = [], [], 0, 0
    for name in names:
        node = nodes[name]
        gaussians = read_gaussian_node(node, share)
        motion = read_motion(node, log, placement.world_from_scene)
        if motion is None or len(gaussians) == 0:
            left_out.append(f"actor {name}: is never present, or has no Gaussians")
            continue
        if not motion.meets(log):
            elsewhere += 1
            continue
        moving += not motion.static
        if node.changing:
            waves.append(name)
        if motion.gaps:
            gaps.append(name)
        own = colours_in_own_frame(gaussians, motion.trajectory, placement.world_from_scene, share)
        found[name] = SceneActor(name, own, extent(own.means), motion.trajectory)
    if elsewhere and not moving:
        raise root.fault(
            "log_timestamps", f"lie outside of log {log.name} for all actors", _SAME_LOG
        )
    adrift = [
        n
        for n, one in nodes.items()
        if one.kind == GROUND and lost(one.gaussians.tensor(NAMES.means, None, 3))
    ]
    motions = {name: actor.trajectory for name, actor in found.items()}
    chosen, told = find_tracks(root, log, motions, given, by_name=True)
    actors, keeping = as_tracks(root, log, found, chosen)
    if elsewhere:
        left_out.append(f"{elsewhere} actors of other drives: their times are not the log's")
    changed = [TURNING] if found else []
    if waves:
        changed.append(
            f"colours of {len(waves)} actors change; those over time are frozen at {share:g} of "
            "it, those with the angle of view are averaged"
        )
    if gaps:
        changed.append(
            f"{', '.join(gaps)}: absent for a while in the scene; interpolated in the import"
        )
    if adrift:
        changed.append(f"{', '.join(adrift)}: moved to the scene by recon2world_translation")
    changed += keeping
    warnings += told
    config = root.table("background").table("config")
    faces = read_environment(config)
    if faces is not None:
        changed.append(RESAMPLED)
    elif "skybox" not in nodes:
        left_out.append(NO_SKY)
    if exposed(config):
        left_out.append("exposure: corrections of single images")
    foreground = sorted(folder.glob("foreground/*.ckpt")) if folder else []
    if foreground:
        left_out.append(f"foreground: {len(foreground)} vehicles to be inserted")
    pose = torch.from_numpy(placement.world_from_scene)
    return write_imported(
        file,
        log,
        out,
        placement,
        StreetScene(
            concatenate(scenery).transformed(pose),
            actors,
            sky_from_cubemap(faces, CUBE_FROM_SCENE @ pose[:3, :3].T.float()),
        ),
        layout="mtgs",
        tracks=chosen,
        changed=changed,
        left_out=left_out,
        warnings=warnings,
    )


def find_checkpoint(path: Path) -> tuple[Path | None, Path]:
    """The scene's folder, if one is given, and its checkpoint. Raises InputError: the folder has no
    checkpoint, or several."""
    if not path.is_dir():
        return None, path
    found = sorted(path.glob("background/*.ckpt"))
    if not found and (path / CHECKPOINT).is_file():
        return path, path / CHECKPOINT
    if len(found) != 1:
        problem = f"has {len(found)} files background/*.ckpt, one is needed"
        raise InputError(path, "scene folder", problem, "name the checkpoint itself")
    return path, found[0]


def read_nodes(
    root: CheckpointTable, leave_out: Sequence[str]
) -> tuple[dict[str, MtgsNode], list[str]]:
    """The nodes that are read, by token with the background first; what is left out."""
    nodes: dict[str, MtgsNode] = {}
    left_out = []
    tokens = [name.rpartition("_")[2] for name in root]
    for name in leave_out:
        if name not in tokens:
            raise root.fault(name, "is to be left out, but is not in the checkpoint", "check it")
    for name, token in sorted(zip(root, tokens, strict=True), key=lambda p: p[1] != "background"):
        node = MtgsNode.of(root, name, token)
        if token in leave_out:
            left_out.append(f"{token}: left out as requested")
        elif node.kind not in (*SCENERY, RIGID, MIRRORED):
            left_out.append(f"{name}: a {node.kind[:60]}, which is not rigid or not known")
        elif token in nodes:
            raise root.fault(name, f"is a second node with token {token}")
        else:
            nodes[token] = node
    return nodes, left_out


def _placement(
    root: CheckpointTable, log: DrivingLog, folder: Path | None
) -> tuple[ScenePlacement, list[str]]:
    """Where the scene lies in the log, and what looks wrong with it."""
    config = root.table("background").table("config")
    pose = se3.from_rotation_translation(np.eye(3), read_shift(config) - log.world_offset)
    how, warnings = "recon2world_translation of the checkpoint", []
    ego, file = read_ego(config), root.path
    if folder is not None and (folder / FRAMES_FILE).exists():
        file = folder / FRAMES_FILE
        ego = read_places([frame for frames in read_drives(file).values() for frame in frames])
    if ego is not None:
        distance, count = distance_to_log(*ego, pose, log)
        if count == 0:
            raise InputError(file, "timestamp", f"no frame is in log {log.name}", _SAME_LOG)
        how += f"; its ego is {distance:.2f} m from the log's (median of {count} frames)"
        if distance > SUSPICIOUS_M:
            warnings.append(f"the ego of the scene is {distance:.2f} m from the log's")
    return ScenePlacement(pose, how), warnings


# The log of a published MTGS street, made of the street's own files, where nuPlan is not at hand.
#
# It has what the files tell: the ego's way, cameras, and the actors as tracks. It has no images, no
# LiDAR and no map.

_SIDES = ("height", "width")
SIZE = (1080, 1920)
"""Height and width of nuPlan's images in pixels, which the files may leave out."""
CATEGORIES = {"vehicle": "car", "bicycle": "cyclist", "pedestrian": "pedestrian"}
_MEND = "give the log that was imported from nuPlan (`log`)"


def import_mtgs_with_log(
    path: str | Path, own_log: str | Path, out: str | Path, **options: Any
) -> ImportRecord:
    """Write the log of a street's own files, and the street as a scene of it.

    Args:
        path: the scene's folder.
        own_log: folder to write the log to.
        options: see `import_mtgs`.

    Raises:
        InputError: see `mtgs_log` and `import_mtgs`. Nothing is written then.
    """
    require_new(out)
    return import_with_log(
        mtgs_log(path), own_log, lambda log: import_mtgs(path, log, out, **options)
    )


def mtgs_log(path: str | Path) -> DrivingLog:
    """The log of a street: of the drive with most frames, if it was recorded on several.

    The rig is nuPlan's ego frame, whose origin is the rear axle, about 0.3 m above the ground.

    Raises:
        InputError: a file is missing, broken or of another layout, or there are fewer than two
            frames.
    """
    folder, file = find_checkpoint(Path(path))
    if folder is None:
        raise InputError(path, "scene folder", "is a file", "name the folder, or give `log`")
    root = read_checkpoint(file, arrays=True)
    drives = read_drives(folder / FRAMES_FILE)
    name, frames = max(drives.items(), key=lambda item: len(item[1]), default=("", []))
    if len(frames) < 2:
        raise InputError(folder / FRAMES_FILE, "drives", "have fewer than two frames", _MEND)
    times, _ = read_places(frames)
    poses = np.stack([_ego_pose(frame) for frame in frames])
    origin = poses[0, :3, 3].copy()
    poses[:, :3, 3] -= origin
    shift = read_shift(root.table("background").table("config"))
    metadata = {"dataset": "nuPlan, as MTGS keeps it", "drive": name, "licence": "that of nuPlan"}
    log = DrivingLog(
        name=f"{file.stem}-{name}" if name else file.stem,
        cameras={key: _camera(key, own) for key, own in _cameras(frames[0]).items()},
        lidars={},
        world_from_rig=Trajectory(times, poses),
        tracks={},
        world_offset=shift + origin,
        metadata={**metadata, "images": "none"},
    )
    with refused(folder / FRAMES_FILE, _MEND):
        log.validate()
    world_from_scene = se3.from_rotation_translation(np.eye(3), -origin)
    log = replace(log, tracks=_tracks(root, log, world_from_scene, _categories(frames)))
    with refused(file, _MEND):
        log.validate()
    return log


def _ego_pose(frame: CheckpointTable) -> Array:
    """(4, 4) of the ego in the scene; `read_places` has checked the place."""
    if "ego2global" in frame:
        pose = frame.array("ego2global")
        if pose.shape == (4, 4) and np.all(np.isfinite(pose)):
            return se3.from_rotation_translation(pose[:3, :3], pose[:3, 3])
    return _placed(frame, "ego2global_rotation", "ego2global_translation")


def _placed(table: CheckpointTable, rotation: str, translation: str) -> Array:
    """(4, 4) of a quaternion wxyz or a matrix, and three metres."""
    turn, place = table.array(rotation), table.array(translation).reshape(-1)
    if turn.shape == (4,) and 1e-6 < np.linalg.norm(turn) < 1e6:
        turn = se3.quat_to_matrix(turn)
    if turn.shape != (3, 3) or not np.all(np.isfinite(turn)):
        raise table.fault(rotation, "is neither a quaternion nor a rotation matrix", _MEND)
    if place.shape != (3,) or not np.all(np.isfinite(place)):
        raise table.fault(translation, "is not three metres", _MEND)
    return se3.from_rotation_translation(turn, place)


def _cameras(frame: CheckpointTable) -> dict[str, CheckpointTable]:
    cameras = frame.table("cams")
    return {name: cameras.table(name) for name in cameras}


def _camera(name: str, own: CheckpointTable) -> CameraStream:
    """A camera without images; the intrinsics that were refined for the training are preferred."""
    lens = own.table("colmap_param") if "colmap_param" in own else own
    matrix, bend = lens.array("cam_intrinsic"), lens.array("distortion").reshape(-1)
    if matrix.shape != (3, 3) or bend.shape != (5,):
        raise lens.fault("cam_intrinsic", "or distortion: is not 3x3, or not five numbers", _MEND)
    height, width = (own.number(key, side) for key, side in zip(_SIDES, SIZE, strict=True))
    if not (1 <= width <= 1e5 and 1 <= height <= 1e5):
        raise own.fault("width", f"or height: {width:g} x {height:g} pixels", _MEND)
    fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    k1, k2, p1, p2, k3 = (float(one) for one in bend)
    size = round(width), round(height)
    camera = PinholeCamera(*size, fx, fy, cx, cy, (k1, k2, p1, p2, k3))
    mount = _placed(own, "sensor2ego_rotation", "sensor2ego_translation")
    return CameraStream(name, camera, mount, np.zeros(0, np.int64), [])


def _categories(frames: Sequence[CheckpointTable]) -> dict[str, str]:
    """The category of each token that the frames name."""
    found: dict[str, str] = {}
    for frame in frames:
        for token, name in zip(frame.texts("track_tokens"), frame.texts("gt_names"), strict=False):
            found.setdefault(token, CATEGORIES.get(name, "misc"))
    return found


def _tracks(
    root: CheckpointTable, log: DrivingLog, world_from_scene: Array, categories: Mapping[str, str]
) -> dict[str, Track]:
    """The actors that are there in the log's time; a vehicle where no category is known."""
    first, last = log.world_from_rig.timestamps_us[[0, -1]]
    tracks = {}
    for token, node in read_nodes(root, ())[0].items():
        if node.kind in SCENERY:
            continue
        motion = read_motion(node, log, world_from_scene)
        means = node.gaussians.tensor(NAMES.means, None, 3)
        if motion is None or len(means) == 0:
            continue
        times = motion.trajectory.timestamps_us
        there = (times >= first) & (times <= last)
        if there.any():
            own = Trajectory(times[there], motion.trajectory.poses[there])
            tracks[token] = Track(token, categories.get(token, "car"), extent(means), own)
    return tracks
