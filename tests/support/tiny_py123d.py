"""A stand-in of the part of py123d's scene interface that is read, with a small drive in it.

Names and meanings are those of py123d 0.7; what is not here, the real one may have, but the
importer must not need. The ego drives along x at 10 m/s, far from the origin.
"""

from __future__ import annotations

import sys
import types
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import shapely

from recast.geometry import se3

NAME, START_US, STEP_US, FRAMES = "log_7", 1_600_000_000_000_000, 100_000, 5
FAR = np.array([5000.0, -2000.0, 40.0])
AXLE_IN_IMU, BOX_IN_AXLE, HEIGHT = [0.1, -0.3, 0.0], [1.4, 0.0, 0.45], 1.5
AXLE_HEIGHT = HEIGHT / 2 - BOX_IN_AXLE[2]
WIDTH, IMAGE_HEIGHT = 24, 16
CAMERA_IN_IMU = np.array([[0, 0, 1, 1.6], [-1, 0, 0, 0.2], [0, -1, 0, 1.1], [0, 0, 0, 1.0]])
LIDARS = {2: ("lidar_top", [1.0, 0.0, 1.6]), 6: ("lidar_rear", [-1.0, 0.1, 0.4])}
POINTS = {2: np.array([[10.0, 2.0, 0.5], [8.0, -1.0, 0.0]]), 6: np.array([[-6.0, 1.0, 0.2]])}
"""In the IMU frame."""


@dataclass(frozen=True)
class Pose:
    transformation_matrix: np.ndarray


def placed(place: Any) -> Pose:
    return Pose(se3.from_rotation_translation(np.eye(3), np.asarray(place, float)))


def there(x: float, y: float, z: float) -> np.ndarray:
    """A place near the drive in py123d's global frame."""
    return FAR + np.array([x, y, z])


def stamp(k: int) -> SimpleNamespace:
    return SimpleNamespace(time_us=START_US + k * STEP_US)


def axle(k: int) -> np.ndarray:
    """Where the rear axle is, in py123d's global frame."""
    return there(10.0 * k * STEP_US / 1e6, 0.0, AXLE_HEIGHT)


def label(name: str) -> SimpleNamespace:
    return SimpleNamespace(name=name)


def box(token: str, own: str, common: str, place: Any, size: Any = (4.5, 1.9, 1.6)) -> Any:
    return SimpleNamespace(
        attributes=SimpleNamespace(
            label=label(own), default_label=label(common), track_token=token
        ),
        bounding_box_se3=SimpleNamespace(
            center_se3=placed(place), length=size[0], width=size[1], height=size[2]
        ),
    )


def boxes(k: int) -> list[Any]:
    return [
        box("ego", "EGO", "EGO", axle(k)),
        box("car", "REGULAR_VEHICLE", "VEHICLE", there(30.0 - 0.8 * k, 4.0, 0.8)),
        box("bus", "SCHOOL_BUS", "VEHICLE", there(50.0, -4.0, 1.5), (11.0, 2.6, 3.0)),
        box("rider", "BICYCLIST", "PERSON", there(20.0, 2.0, 0.9), (1.8, 0.6, 1.7)),
    ]


def camera_metadata(name: str, model: str, **changes: Any) -> SimpleNamespace:
    values = {
        "camera_name": name,
        "camera_model": label(model),
        "intrinsics": SimpleNamespace(fx=20.0, fy=21.0, cx=12.0, cy=8.0, skew=0.0),
        "distortion": SimpleNamespace(k1=0.1, k2=-0.2, p1=0.01, p2=0.02, k3=0.3),
        "is_undistorted": False,
        "width": WIDTH,
        "height": IMAGE_HEIGHT,
        "camera_to_imu_se3": Pose(CAMERA_IN_IMU),
    }
    return SimpleNamespace(**values | changes)


def picture(k: int) -> np.ndarray:
    return np.full((IMAGE_HEIGHT, WIDTH, 3), [10 * k, 100, 200], np.uint8)


def line(start: Any, end: Any) -> SimpleNamespace:
    return SimpleNamespace(array=np.linspace(FAR + start, FAR + end, 5))


def flat(lanes: list[Any]) -> list[Any]:
    """As the real one does with maps without heights: they are zero."""
    for found in lanes:
        for name in ("left_boundary_3d", "right_boundary_3d", "centerline_3d"):
            getattr(found, name).array[:, 2] = 0.0
    return lanes


def lane(key: int, y: float, kind: str, **links: Any) -> SimpleNamespace:
    first, last = [-20.0, y, 0.0], [90.0, y, 0.0]
    left, right = [0.0, 1.7, 0.0], [0.0, -1.7, 0.0]
    sides = {
        side: line(np.add(first, shift), np.add(last, shift))
        for side, shift in (("left", left), ("right", right), ("center", [0.0, 0.0, 0.0]))
    }
    outline = np.concatenate([sides["right"].array, sides["left"].array[::-1]])
    values = {
        "object_id": key,
        "lane_type": label(kind),
        "left_boundary_3d": sides["left"],
        "right_boundary_3d": sides["right"],
        "centerline_3d": sides["center"],
        "shapely_polygon": shapely.Polygon(outline),
        "speed_limit_mps": None,
        "successor_ids": [],
        "left_lane_id": None,
        "right_lane_id": None,
    }
    return SimpleNamespace(**values | links)


class Map:
    def __init__(self, lanes: list[Any], map_has_z: bool = True) -> None:
        self.map_has_z = map_has_z
        group = SimpleNamespace(
            lane_ids=[2], intersection_id=9, shapely_polygon=lanes[0].shapely_polygon
        )
        self.layers = {"lane": lanes, "lane_group": [group], "crosswalk": []}

    def get_available_map_layers(self) -> list[Any]:
        return [label(layer.upper()) for layer in self.layers]

    def query(self, geometry: Any, layers: list[str], predicate: str) -> dict[Any, list[Any]]:
        assert predicate == "intersects"
        return {
            layer: [o for o in self.layers[layer] if o.shapely_polygon.intersects(geometry)]
            for layer in layers
        }


def lanes() -> list[Any]:
    return [
        lane(1, 0.0, "SURFACE_STREET", speed_limit_mps=13.9, successor_ids=[2, 77], left_lane_id=2),
        lane(2, 3.4, "UNDEFINED", right_lane_id=1),
        lane(3, -3.4, "BIKE_LANE"),
    ]


@dataclass
class Scene:
    """What a test may change; `merged` keeps the points of all LiDARs in one cloud."""

    merged: bool = True
    cameras: dict[str, Any] = field(
        default_factory=lambda: {
            "pcam_f0": camera_metadata("front", "PINHOLE"),
            "fmcam_l": camera_metadata("left_fisheye", "FISHEYE_MEI"),
        }
    )
    pictures: Any = picture
    detections: Any = boxes
    ids: bool = True
    map: Any = field(default_factory=lambda: Map(lanes()))
    states: int = FRAMES

    def get_log_metadata(self) -> Any:
        return SimpleNamespace(
            dataset="av2-sensor", split="av2-sensor_val", log_name=NAME, location="pittsburgh"
        )

    def get_map_api(self) -> Any:
        return self.map

    def get_ego_state_se3_metadata(self) -> Any:
        return SimpleNamespace(
            height=HEIGHT,
            rear_axle_to_imu_se3=placed(AXLE_IN_IMU),
            center_to_imu_se3=placed(np.add(AXLE_IN_IMU, BOX_IN_AXLE)),
        )

    def get_all_ego_state_se3_timestamps(self) -> list[Any]:
        return [stamp(k) for k in range(self.states)]

    def get_ego_state_se3_at_timestamp(self, timestamp: int) -> Any:
        return SimpleNamespace(imu_se3=placed(axle(_frame(timestamp)) - AXLE_IN_IMU))

    def get_all_box_detections_se3_timestamps(self) -> list[Any]:
        return [stamp(k) for k in range(FRAMES)]

    def get_box_detections_se3_at_timestamp(self, timestamp: int) -> Any:
        return self.detections(_frame(timestamp))

    def get_camera_metadatas(self) -> dict[str, Any]:
        return self.cameras

    def get_all_camera_timestamps(self, camera_id: str) -> list[Any]:
        return [stamp(k) for k in range(FRAMES + 5)]  # beyond the last ego state

    def get_camera_at_timestamp(self, timestamp: int, camera_id: str) -> Any:
        image = self.pictures(_frame(timestamp))
        return None if image is None else SimpleNamespace(rgb_image=image)

    def get_lidar_metadatas(self) -> dict[Any, Any]:
        return {
            key: SimpleNamespace(lidar_name=name, lidar_to_imu_se3=placed(place))
            for key, (name, place) in LIDARS.items()
        }

    def get_all_lidar_timestamps(self, lidar_id: Any) -> list[Any]:
        known = lidar_id == "lidar_merged" if self.merged else lidar_id in LIDARS
        return [stamp(k) for k in range(FRAMES)] if known else []

    def get_lidar_at_timestamp(self, timestamp: int, lidar_id: int) -> Any:
        """As the real one does: of a merged log, the cloud of all LiDARs, whichever is asked."""
        keys = list(POINTS) if self.merged else [lidar_id]
        ids = np.concatenate([np.full(len(POINTS[key]), key, np.uint8) for key in keys])
        return SimpleNamespace(
            point_cloud_3d=np.concatenate([POINTS[key] for key in keys]).astype(np.float32),
            is_merged=self.merged,
            ids=ids if self.merged and self.ids else None,
            intensity=(ids * 25).astype(np.uint8),
            timestamps=None,
        )


def _frame(timestamp: int) -> int:
    k, rest = divmod(timestamp - START_US, STEP_US)
    assert rest == 0 and isinstance(timestamp, int)
    return k


def install(monkeypatch: pytest.MonkeyPatch, root: Path, scene: Any) -> Path:
    """Have `import py123d...` find the stand-in, and write the log's folder with its first file."""
    folder = root / "logs" / "av2-sensor_val" / NAME
    folder.mkdir(parents=True, exist_ok=True)
    times = pa.table({"timestamp_us": [START_US + k * STEP_US for k in range(FRAMES)]})
    with pa.ipc.new_file(str(folder / "sync.arrow"), times.schema) as writer:
        writer.write_table(times)

    def opened(log_dir: Path, maps_root: Path) -> Any:
        assert log_dir == folder and maps_root == root / "maps"
        return scene

    name = "py123d"
    monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    for part in ("api", "scene", "arrow", "arrow_scene_api"):
        name = f"{name}.{part}"
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    sys.modules[name].ArrowSceneAPI = opened  # type: ignore[attr-defined]
    return root
