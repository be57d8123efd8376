"""Logs in the unified format of the `py123d` package, whatever dataset they came from.

Source: the scene interface of py123d 0.7 (https://github.com/kesai-labs/py123d), which is an
optional package and imported here only.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.spatial import cKDTree

from recast.core.errors import InputError
from recast.core.table_files import check_batches
from recast.geometry import se3
from recast.logs import motion
from recast.logs.checks import refused
from recast.logs.hdmap import HdMap, Lane
from recast.logs.importers.common import (
    LISTED,
    NEAR,
    chosen_cameras,
    lane_outline,
    metres_beside,
    returns_valid,
    unknown_drive,
)
from recast.logs.types import Array, DrivingLog, Trajectory
from recast_bridges.logs.py123d_sensors import (
    matrix,
    read_cameras,
    read_lidars,
    read_tracks,
    reading,
)

REACH = 150.0
"""Metres around the drive: some maps are of a whole city."""
NOT_FOR_CARS = ("BIKE_LANE",)
AREAS = ("lane", "lane_group", "intersection", "generic_drivable", "carpark")
"""Layers whose surfaces one can drive on."""
SYNC = "sync.arrow"
_LARGEST_BATCH = 1 << 30
"""Bytes in memory."""


@returns_valid
def load_py123d(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """Read a log, with its map if it has one; images and sweeps are decoded when asked for.

    Args:
        root: py123d's data folder, which holds `logs` and `maps`.
        drive: the log's name.
        labels: must be None, since a log holds its own.
        cameras: py123d's names of the cameras to read; all if empty.

    Raises:
        InputError: py123d is not installed or cannot read the log, or the log lacks what is
            needed.
    """
    if labels is not None:
        raise InputError(labels, "labels", "are already in the py123d log", "leave the option out")
    folder = find_log(Path(root), drive)
    scene_type = _scene_type()
    for path in sorted(folder.glob("*.arrow")):  # py123d maps them into memory as they are
        check_batches(path, "convert the log again", _LARGEST_BATCH)
    with reading(folder):
        scene = scene_type(folder, maps_root=Path(root) / "maps")
        return log_of(scene, folder, cameras)


def log_of(scene: Any, folder: Path, cameras: Sequence[str] = ()) -> DrivingLog:
    """The log of a py123d scene.

    Args:
        scene: a `py123d.api.SceneAPI`.
        folder: folder that messages name.
        cameras: names of the cameras to keep; all if empty.

    Raises:
        InputError: there are fewer than two ego poses, or a sensor or box is not as it must be.
    """
    ego = scene.get_ego_state_se3_metadata()
    times = [time.time_us for time in scene.get_all_ego_state_se3_timestamps()]
    if ego is None or len(times) < 2:
        raise InputError(folder, "ego states", "there are fewer than two", "convert the log again")
    rig_from_imu = _rig_from_imu(ego)
    poses = np.stack(
        [matrix(scene.get_ego_state_se3_at_timestamp(time).imu_se3) for time in times]
    ) @ se3.inverse(rig_from_imu)
    offset: Array = poses[0, :3, 3].copy()
    poses[:, :3, 3] -= offset
    trajectory = Trajectory(np.array(times, np.int64), poses)
    with refused(folder, "convert the log again"):
        trajectory.validate("ego states")
    trajectory = motion.extended(
        trajectory, times[0] - motion.MAX_EXTENSION_US, times[-1] + motion.MAX_EXTENSION_US
    )
    streams, left_out = read_cameras(scene, folder, rig_from_imu, trajectory)
    chosen = chosen_cameras(folder, streams, cameras)
    known = scene.get_log_metadata()
    metadata = {
        "dataset": f"{known.dataset}, through py123d",
        "drive": known.log_name,
        "split": known.split,
        "licence": f"that of {known.dataset}",
        **({} if known.location is None else {"location": known.location}),
        **({"cameras_left_out": ", ".join(left_out)} if left_out else {}),
    }
    return DrivingLog(
        name=known.log_name,
        cameras={name: streams[name] for name in chosen},
        lidars=read_lidars(scene, folder, rig_from_imu, trajectory),
        world_from_rig=trajectory,
        tracks=read_tracks(scene, folder, trajectory, offset),
        map=read_map(scene.get_map_api(), folder, trajectory.poses[:, :3, 3], offset),
        world_offset=offset,
        metadata=metadata,
    )


def _rig_from_imu(ego: Any) -> Array:
    """The rig stands below the rear axle on the ground, which is the underside of the ego's box."""
    imu_from_axle, imu_from_box = matrix(ego.rear_axle_to_imu_se3), matrix(ego.center_to_imu_se3)
    axle_from_box = se3.inverse(imu_from_axle) @ imu_from_box
    rig_from_axle = np.eye(4)
    rig_from_axle[2, 3] = ego.height / 2 - axle_from_box[2, 3]
    return rig_from_axle @ se3.inverse(imu_from_axle)


def find_log(root: Path, drive: str) -> Path:
    """The folder of log `drive` below `root`/logs.

    Raises:
        InputError: the folder or the log does not exist, or several have the name.
    """
    logs = root / "logs"
    if not logs.is_dir():
        raise InputError(
            root, "py123d data", "has no folder logs", "name the folder that contains logs"
        )
    known = sorted(path.parent for path in logs.rglob(SYNC))
    found = [folder for folder in known if folder.name == drive]
    if len(found) > 1:
        listed = ", ".join(str(folder.relative_to(logs)) for folder in found[:LISTED])
        raise InputError(root, f"drive {drive}", f"is ambiguous: {listed}", "remove one of them")
    if not found:
        raise unknown_drive(
            root, drive, (one.name for one in known), "check the path: no drive was found"
        )
    return found[0]


def _scene_type() -> Any:
    """`ArrowSceneAPI`: the scene of a whole log."""
    try:
        return importlib.import_module("py123d.api.scene.arrow.arrow_scene_api").ArrowSceneAPI
    except ImportError as error:
        problem = f"cannot be imported ({error})"
        raise InputError("py123d", "package", problem, "pip install 'py123d>=0.7'") from None


def read_map(api: Any, folder: Path, ego: Array, offset: Array) -> HdMap | None:
    """The map in the world frame, or None where the log has none or one without lanes.

    Args:
        api: a `py123d.api.MapAPI`, or None.
        folder: folder that messages name.
        ego: (T, 3) places of the ego in the world.
        offset: (3,) py123d's global coordinates = world coordinates + this.

    Raises:
        InputError: the map lies elsewhere than the drive.
    """
    if api is None:
        return None
    near = shapely.LineString((ego + offset)[:, :2]).buffer(REACH)
    layers = {layer.name.lower() for layer in api.get_available_map_layers()}
    surfaces = {
        layer: [
            surface
            for found in api.query(near, [layer], "intersects").values()
            for surface in found
        ]
        for layer in AREAS
        if layer in layers
    }
    driven = [lane for lane in surfaces.get("lane", []) if lane.lane_type.name not in NOT_FOR_CARS]
    if not driven:
        return None
    known = {str(lane.object_id) for lane in driven}
    crossing = {
        str(key)
        for group in surfaces.get("lane_group", [])
        if group.intersection_id is not None
        for key in group.lane_ids
    }
    heights = None if api.map_has_z else ego
    lanes = {str(lane.object_id): _lane(lane, known, crossing, offset, heights) for lane in driven}
    distance = metres_beside(lanes, ego[:, :2])
    if distance > NEAR:
        problem = (
            f"the ego drives {distance:.0f} m away from all lanes: the map is of another drive"
        )
        raise InputError(folder, "map", problem, "convert the log again")
    areas = tuple(
        np.asarray(surface.shapely_polygon.exterior.coords)[:-1, :2] - offset[:2]
        for found in surfaces.values()
        for surface in found
    )
    return HdMap(lanes=lanes, drivable_area=areas, notes={"source": "py123d"})


def _lane(
    lane: Any, known: set[str], crossing: set[str], offset: Array, heights: Array | None
) -> Lane:
    """`heights` are places (T, 3) that give a flat map its heights: those of the nearest."""

    def line(name: str) -> Array:
        points = np.asarray(getattr(lane, f"{name}_3d").array, np.float64) - offset
        if heights is not None:
            points[:, 2] = heights[cKDTree(heights[:, :2]).query(points[:, :2])[1], 2]
        return points

    def named(key: Any) -> str | None:
        return str(key) if key is not None and str(key) in known else None

    left, right, limit = line("left_boundary"), line("right_boundary"), lane.speed_limit_mps
    return Lane(
        lane_id=str(lane.object_id),
        centreline=line("centerline"),
        left_boundary=left,
        right_boundary=right,
        polygon=lane_outline(left, right),
        speed_limit=float(limit) if limit else None,
        successors=tuple(str(key) for key in lane.successor_ids if str(key) in known),
        left_neighbour=named(lane.left_lane_id),
        right_neighbour=named(lane.right_lane_id),
        is_intersection=str(lane.object_id) in crossing,
    )
