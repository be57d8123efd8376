"""A small nuScenes dataset in its own layout, written from nothing.

The ego drives 30 degrees north of east, far from the map's origin. Truth is told in the street's
frame: x along the road, z up, origin on the ground under the ego's first rear axle.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from recast.geometry import se3

SCENE, VERSION = "scene-0061", "v1.0-mini"
START_US = 1_532_402_927_000_000
SECONDS, SPEED = 2.0, 5.0
KEY_US, CAMERA_US, SWEEP_US = 500_000, 83_334, 50_000
GLOBAL_FROM_STREET = se3.from_rotation_translation(
    se3.rotation_z(np.radians(30.0)), [400.0, 1100.0, 0.0]
)
EGO_FROM_CAMERA = se3.from_rotation_translation(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), [1.7, 0.1, 1.5]
)
EGO_FROM_LIDAR = se3.from_rotation_translation(
    np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), [0.94, 0.0, 1.84]
)
K = np.array([[60.0, 0.0, 31.5], [0.0, 62.0, 23.5], [0.0, 0.0, 1.0]])
WIDTH, HEIGHT = 64, 48
CAR_SIZE = np.array([4.0, 1.8, 1.5])  # length, width, height
CAR_POINTS = 40
LAMP = np.array([30.0, 2.0, 3.0])  # a bright point of the street, painted in every image


def street_from_ego(seconds: float) -> np.ndarray:
    """The ego frame at a time: the rear axle on the ground."""
    return se3.from_rotation_translation(np.eye(3), [SPEED * seconds, 0.0, 0.0])


def street_from_car(seconds: float) -> np.ndarray:
    """A car ahead, turned and drifting so that every axis shows."""
    return se3.from_rotation_translation(
        se3.rotation_z(np.radians(20.0)), [15.0 + 2.0 * seconds, 1.0, CAR_SIZE[2] / 2]
    )


def pixel_of(street: np.ndarray, seconds: float) -> np.ndarray:
    """Pixel (centres at whole numbers, as the dataset's tools have it) of a point of the street."""
    camera_from_street = np.linalg.inv(street_from_ego(seconds) @ EGO_FROM_CAMERA)
    u, v, depth = K @ (camera_from_street @ np.append(street, 1.0))[:3]
    return np.array([u, v]) / depth


def write_tiny_nuscenes(root: Path) -> Path:
    """Write the dataset into `root`; returns its folder of tables."""
    tables: dict[str, list[dict[str, Any]]] = {
        "attribute": [],
        "visibility": [],
        "map": [
            {
                "token": "map",
                "log_tokens": ["log"],
                "category": "semantic_prior",
                "filename": "maps/raster.png",
            }
        ],
        "log": [
            {
                "token": "log",
                "logfile": "n015",
                "vehicle": "n015",
                "date_captured": "2018-07-24",
                "location": "singapore-onenorth",
            }
        ],
        "scene": [
            {
                "token": token,
                "name": name,
                "log_token": "log",
                "nbr_samples": 5,
                "first_sample_token": "",
                "last_sample_token": "",
                "description": 'Parked, "}]',
            }
            for token, name in (("other", "scene-0103"), ("mine", SCENE))
        ],
        "sensor": [
            {"token": "s-cam", "channel": "CAM_FRONT", "modality": "camera"},
            {"token": "s-lidar", "channel": "LIDAR_TOP", "modality": "lidar"},
            {"token": "s-radar", "channel": "RADAR_FRONT", "modality": "radar"},
        ],
        "calibrated_sensor": [
            _posed("c-cam", EGO_FROM_CAMERA, sensor_token="s-cam", camera_intrinsic=K.tolist()),
            _posed("c-lidar", EGO_FROM_LIDAR, sensor_token="s-lidar", camera_intrinsic=[]),
            _posed("c-radar", np.eye(4), sensor_token="s-radar", camera_intrinsic=[]),
        ],
        "category": [
            {"token": "k-car", "name": "vehicle.car", "description": ""},
            {"token": "k-walk", "name": "human.pedestrian.adult", "description": ""},
            {"token": "k-ego", "name": "vehicle.ego", "description": ""},
        ],
        "instance": [
            {"token": name, "category_token": f"k-{name}", "nbr_annotations": 5}
            for name in ("car", "walk", "ego")
        ],
        "sample": [],
        "sample_data": [],
        "ego_pose": [],
        "sample_annotation": [],
    }
    _write_key_frames(tables)
    _write_frames(root, tables)
    # Another scene's frame, whose files were not downloaded.
    elsewhere = tables["sample_data"][0] | {"token": "x", "sample_token": "x", "filename": "x.jpg"}
    tables["sample"].insert(0, {"token": "x", "timestamp": START_US, "scene_token": "other"})
    tables["sample_data"].insert(0, elsewhere)
    for name, rows in tables.items():
        write_table(root / VERSION, name, rows)
    return root / VERSION


def read_table(tables: Path, name: str) -> list[dict[str, Any]]:
    """Rows of a table."""
    return json.loads((tables / f"{name}.json").read_text())


def write_table(tables: Path, name: str, rows: list[dict[str, Any]]) -> None:
    """A table in the dataset's own indentation."""
    tables.mkdir(parents=True, exist_ok=True)
    (tables / f"{name}.json").write_text(json.dumps(rows, indent=0))


def _posed(token: str, pose: np.ndarray, **columns: object) -> dict[str, Any]:
    quat, place = se3.matrix_to_quat(pose[:3, :3]), pose[:3, 3]
    return {"token": token, "rotation": quat.tolist(), "translation": place.tolist(), **columns}


def _write_key_frames(tables: dict[str, list[dict[str, Any]]]) -> None:
    for k in range(int(SECONDS * 1e6) // KEY_US + 1):
        time = k * KEY_US
        sample = {"token": f"key{k}", "timestamp": START_US + time, "scene_token": "mine"}
        tables["sample"].append(sample)
        walk = se3.from_rotation_translation(np.eye(3), [12.0, -5.0 + 0.6 * k, 0.9])
        for name, size, pose in (
            ("car", CAR_SIZE, street_from_car(time / 1e6)),
            ("walk", np.array([0.6, 0.7, 1.8]), walk),
            ("ego", np.array([4.0, 1.7, 1.6]), street_from_ego(time / 1e6)),
        ):
            row = _posed(
                f"{name}{k}",
                GLOBAL_FROM_STREET @ pose,
                sample_token=f"key{k}",
                instance_token=name,
                size=size[[1, 0, 2]].tolist(),
                num_lidar_pts=CAR_POINTS,
            )
            tables["sample_annotation"].append(row)


def _write_frames(root: Path, tables: dict[str, list[dict[str, Any]]]) -> None:
    for channel, mount, step, suffix, size in (
        ("CAM_FRONT", "c-cam", CAMERA_US, ".jpg", (WIDTH, HEIGHT)),
        ("LIDAR_TOP", "c-lidar", SWEEP_US, ".pcd.bin", (0, 0)),
        ("RADAR_FRONT", "c-radar", 400_000, ".pcd", (0, 0)),
    ):
        for time in range(0, int(SECONDS * 1e6) + 100, step):
            key = time % KEY_US < step
            folder = "samples" if key else "sweeps"
            token, stamp = f"{channel}-{time}", START_US + time
            name = f"{folder}/{channel}/n015__{channel}__{stamp}{suffix}"
            tables["sample_data"].append(
                {
                    "token": token,
                    "sample_token": f"key{time // KEY_US + (not key)}",
                    "ego_pose_token": token,
                    "calibrated_sensor_token": mount,
                    "filename": name,
                    "fileformat": "jpg" if suffix == ".jpg" else "pcd",
                    "width": size[0],
                    "height": size[1],
                    "timestamp": stamp,
                    "is_key_frame": key,
                    "prev": "",
                    "next": "",
                }
            )
            pose = GLOBAL_FROM_STREET @ street_from_ego(time / 1e6)
            tables["ego_pose"].append(_posed(token, pose, timestamp=stamp))
            path = root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if suffix == ".jpg":
                _write_image(path, time / 1e6)
            elif suffix == ".pcd.bin":
                sweep_rows(time / 1e6).astype("<f4").tofile(path)


def _write_image(path: Path, seconds: float) -> None:
    pixels = np.full((HEIGHT, WIDTH, 3), 20, np.uint8)
    column, row = np.rint(pixel_of(LAMP, seconds)).astype(int)
    pixels[row - 2 : row + 3, column - 2 : column + 3] = 250
    Image.fromarray(pixels).save(path, quality=95)


def sweep_rows(seconds: float) -> np.ndarray:
    """Rows (N, 5): 40 points in the car, 100 on the road, 9 on the ego's own roof."""
    generator = np.random.default_rng(round(seconds * 1e6))
    in_box = (generator.random((CAR_POINTS, 3)) - 0.5) * (CAR_SIZE - 0.2)
    road = np.column_stack(
        [generator.uniform(-20, 30, 100), generator.uniform(-6, -3, 100), np.zeros(100)]
    )
    street = np.concatenate([se3.apply(street_from_car(seconds), in_box), road])
    lidar_from_street = se3.inverse(street_from_ego(seconds) @ EGO_FROM_LIDAR)
    roof = generator.uniform(-0.9, 0.9, (9, 3))
    points = np.concatenate([se3.apply(lidar_from_street, street), roof])
    intensity = np.linspace(0, 255, len(points))
    return np.column_stack([points, intensity, np.arange(len(points)) % 32])
