"""Cameras, LiDARs and boxes of a py123d scene."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.spatial import cKDTree

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.images import eight_bits
from recast.core.table_files import check_batches
from recast.geometry import se3
from recast.logs import checks, motion
from recast.logs.checks import refused
from recast.logs.hdmap import HdMap, Lane
from recast.logs.importers.common import (
    LISTED,
    NEAR,
    Timed,
    are_returns,
    chosen_cameras,
    lane_outline,
    metres_beside,
    returns_valid,
    unit_intensity,
    unknown_drive,
)
from recast.logs.types import (
    Array,
    CameraStream,
    DrivingLog,
    Image,
    Int64Array,
    LidarStream,
    LidarSweep,
    Track,
    Trajectory,
)

_MEND = "convert the log again"
CATEGORIES = {
    "VEHICLE": "car",
    "TRAIN": "tram",
    "TWO_WHEELER": "cyclist",
    "PERSON": "pedestrian",
    "ANIMAL": "misc",
    "TRAFFIC_SIGN": "misc",
    "TRAFFIC_CONE": "misc",
    "TRAFFIC_LIGHT": "misc",
    "BARRIER": "misc",
    "GENERIC_OBJECT": "misc",
    "OTHER": "misc",
}
"""By py123d's common labels."""
WORDS = {"BUS": "bus", "TRUCK": "truck", "TRAILER": "trailer", "LARGE": "truck", "VAN": "van"}
"""Words of a dataset's own label that tell more about a vehicle."""
MOTORCYCLES = {"MOTORCYCLE", "MOTORCYCLIST"}
RIDERS = {"CYCLIST", "BICYCLIST", "RIDER"}
"""Words of a dataset's own label of a person who is part of a two-wheeler."""
EGO = "EGO"


@contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Turn whatever py123d raises inside the block into one line that names the log."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # it asserts, and lets through what Arrow and others raise
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(
            folder, "log", f"py123d cannot read it ({said})", "convert it again"
        ) from error


def matrix(pose: Any) -> Array:
    """The (4, 4) of a `py123d.geometry.PoseSE3`."""
    return np.asarray(pose.transformation_matrix, np.float64)


@dataclass(frozen=True)
class Py123dImages(Timed):
    """The images of one camera, decoded by py123d when asked for."""

    scene: Any
    camera_id: Any
    name: str
    timestamps_us: Int64Array
    camera: PinholeCamera
    folder: Path

    def __getitem__(self, index: int) -> Image:
        """Decode frame `index` to (height, width, 3) uint8 RGB. Raises InputError: it is missing,
        or of another size than the calibration says."""
        time = int(self.timestamps_us[index])
        where = f"camera {self.name} at {time} us"
        with reading(self.folder):
            found = self.scene.get_camera_at_timestamp(time, self.camera_id)
            if found is None:
                raise InputError(self.folder, where, "has no image", _MEND)
            image = eight_bits(found.rgb_image)
        expected = (self.camera.height, self.camera.width, 3)
        if image.shape != expected:
            problem = f"has an image of {image.shape}, but its calibration says {expected}"
            raise InputError(self.folder, where, problem, _MEND)
        return image


def read_cameras(
    scene: Any, folder: Path, rig_from_imu: Array, trajectory: Trajectory
) -> tuple[dict[str, CameraStream], list[str]]:
    """Pinhole cameras by name, and the names of the others, which are left out. Raises InputError:
    a camera has no intrinsics, or some that a pinhole camera has not."""
    streams, left_out = {}, []
    for camera_id, known in scene.get_camera_metadatas().items():
        name = known.camera_name
        if known.camera_model.name != "PINHOLE":
            left_out.append(name)
            continue
        camera = _camera(folder, known)
        times = _within(scene.get_all_camera_timestamps(camera_id), trajectory)
        images = Py123dImages(scene, camera_id, name, times, camera, folder)
        mount = rig_from_imu @ matrix(known.camera_to_imu_se3)
        streams[name] = CameraStream(name, camera, mount, times, images)
    return streams, left_out


def _camera(folder: Path, known: Any) -> PinholeCamera:
    where, intrinsics = f"camera {known.camera_name}", known.intrinsics
    if intrinsics is None:
        raise InputError(folder, where, "has no intrinsics", _MEND)
    if intrinsics.skew != 0:
        raise InputError(
            folder, where, f"has a skew of {intrinsics.skew:g}", "undistort its images"
        )
    lens = None if known.is_undistorted else known.distortion
    k1, k2, p1, p2, k3 = (
        (0.0,) * 5 if lens is None else (lens.k1, lens.k2, lens.p1, lens.p2, lens.k3)
    )
    focal = float(intrinsics.fx), float(intrinsics.fy)
    centre = float(intrinsics.cx), float(intrinsics.cy)
    distortion = (float(k1), float(k2), float(p1), float(p2), float(k3))
    camera = PinholeCamera(int(known.width), int(known.height), *focal, *centre, distortion)
    try:
        camera.validate()
    except ValueError as error:
        raise InputError(folder, where, str(error), _MEND) from None
    return camera


@dataclass(frozen=True)
class Py123dSweeps(Timed):
    """The sweeps of one LiDAR, decoded by py123d when asked for.

    A cloud of several scanners, which is how py123d may keep them, is parted by its point ids.
    """

    scene: Any
    lidar_id: Any
    name: str
    timestamps_us: Int64Array
    rig_from_imu: Array
    imu_from_lidar: Array
    folder: Path

    def __getitem__(self, index: int) -> LidarSweep:
        """Decode sweep `index`; py123d's points are in the IMU frame at the sweep's time. Raises
        InputError: it is missing, or points of several scanners cannot be told apart."""
        time = int(self.timestamps_us[index])
        with reading(self.folder):
            return self._sweep(time, self.scene.get_lidar_at_timestamp(time, self.lidar_id))

    def _sweep(self, time: int, found: Any) -> LidarSweep:
        where = f"LiDAR {self.name} at {time} us"
        if found is None:
            raise InputError(self.folder, where, "has no points", _MEND)
        points = np.asarray(found.point_cloud_3d, np.float64)
        mine = np.ones(len(points), bool)
        if found.is_merged:
            if found.ids is None:
                problem = "is merged with other LiDARs, and its points have no LiDAR ids"
                raise InputError(self.folder, where, problem, _MEND)
            mine = found.ids == int(self.lidar_id)
        mine &= are_returns(points, self.imu_from_lidar[:3, 3])
        times, intensity = found.timestamps, found.intensity
        brightness = np.zeros(len(points)) if intensity is None else np.asarray(intensity)
        return LidarSweep(
            time,
            se3.apply(self.rig_from_imu, points[mine]).astype(np.float32),
            unit_intensity(brightness[mine]),
            None if times is None else np.asarray(times, np.int64)[mine],
        )


def read_lidars(
    scene: Any, folder: Path, rig_from_imu: Array, trajectory: Trajectory
) -> dict[str, LidarStream]:
    """LiDARs by name."""
    streams = {}
    for lidar_id, known in scene.get_lidar_metadatas().items():
        name = known.lidar_name
        own = scene.get_all_lidar_timestamps(lidar_id)
        times = _within(own or scene.get_all_lidar_timestamps("lidar_merged"), trajectory)
        imu_from_lidar = matrix(known.lidar_to_imu_se3)
        sweeps = Py123dSweeps(scene, lidar_id, name, times, rig_from_imu, imu_from_lidar, folder)
        streams[name] = LidarStream(name, rig_from_imu @ imu_from_lidar, times, sweeps)
    return streams


def _within(times: list[Any], trajectory: Trajectory) -> Int64Array:
    """Sensors start and stop within a cycle of the ego states: what is beyond is left out."""
    listed = [int(time.time_us) for time in times]
    return np.array([time for time in listed if trajectory.covers(time)], np.int64)


def read_tracks(
    scene: Any, folder: Path, trajectory: Trajectory, offset: Array
) -> dict[str, Track]:
    """Tracks by py123d's track token; the ego's own box is left out. Raises InputError: a label is
    unknown, a box has no size or comes twice at a time."""
    found: dict[str, list[tuple[int, Any]]] = {}
    for stamp in scene.get_all_box_detections_se3_timestamps():
        time = int(stamp.time_us)
        boxes = scene.get_box_detections_se3_at_timestamp(time)
        if boxes is None or not trajectory.covers(time):
            continue
        for box in boxes:
            if box.attributes.default_label.name == EGO:
                continue
            rows = found.setdefault(str(box.attributes.track_token), [])
            if rows and rows[-1][0] == time:
                where = f"box {box.attributes.track_token} at {time} us"
                raise InputError(folder, where, "appears twice", "convert the log again")
            rows.append((time, box))
    return {token: _track(folder, token, rows, offset) for token, rows in found.items()}


def _track(folder: Path, token: str, rows: list[tuple[int, Any]], offset: Array) -> Track:
    boxes = [box.bounding_box_se3 for _, box in rows]
    sizes = np.array([[box.length, box.width, box.height] for box in boxes], np.float64)
    poses = np.stack([matrix(box.center_se3) for box in boxes])
    if not np.isfinite(poses).all() or not checks.are_box_sides(sizes).all():
        problem = "has a box without a valid position or size"
        raise InputError(folder, f"track {token}", problem, "convert the log again")
    poses[:, :3, 3] -= offset
    attributes = rows[0][1].attributes
    kind = category(attributes.label.name, attributes.default_label.name)
    if kind is None:
        problem = f"has the label {attributes.default_label.name}, which recast does not know"
        raise InputError(folder, f"track {token}", problem, f"use one of {', '.join(CATEGORIES)}")
    times = np.array([time for time, _ in rows], np.int64)
    return Track(token, kind, np.median(sizes, axis=0), Trajectory(times, poses))


def category(label: str, common: str) -> str | None:
    """Our category of a dataset's own label and py123d's common one; None where unknown."""
    words = label.upper().split("_")
    if MOTORCYCLES.intersection(words):
        return "motorcyclist"
    if common == "VEHICLE":
        return next((WORDS[word] for word in words if word in WORDS), CATEGORIES[common])
    if common == "PERSON" and RIDERS.intersection(words):
        return "cyclist"
    return CATEGORIES.get(common)


# Logs in the unified format of the `py123d` package, whatever dataset they came from.
#
# Source: the scene interface of py123d 0.7 (https://github.com/kesai-labs/py123d), which is an
# optional package and imported here only.

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
    """The folder of log `drive` below `root`/logs. Raises InputError: the folder or the log does
    not exist, or several have the name."""
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
