"""A small Waymo scene as Street Gaussians and as DriveStudio lay it out, written from nothing.

The ego drives 30 degrees north of east, far from the origin. Truth is told in the street's frame: x
along the road, z up, origin on the ground under the ego at second 0.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image

from recast.geometry import se3

SCENE = "002"
FRAMES, SPEED = 12, 8.0
START = 1_507_000_000.25  # seconds
FRAME_DELAY = 0.047  # from the beginning of a scan to the time of the frame's pose
CAMERA_DELAY = {0: 0.048, 1: 0.036}
CAMERA_NAMES = {0: "FRONT", 1: "FRONT_LEFT"}
GLOBAL_FROM_STREET = se3.from_rotation_translation(
    se3.rotation_z(np.radians(30.0)), [-12_400.0, 23_100.0, 25.0]
)
WIDTH, HEIGHT = 64, 48
INTRINSIC = (60.0, 61.0, 32.5, 23.0, 0.04, -0.33, 0.001, -0.002, 0.0)
CAR_SIZE = np.array([4.0, 1.8, 1.5])  # length, width, height
LAMP = np.array([30.0, 4.0, 3.0])  # a bright point of the street, painted in every image
LASERS = {0: (1.43, 0.0, 2.18), 4: (-1.1, 0.0, 0.5)}  # number: place
LASER_POINTS = 30


def vehicle_from_waymo_camera(camera: int) -> np.ndarray:
    """Mounting; Waymo's camera axes: x forward, y left, z up."""
    return se3.from_rotation_translation(
        se3.rotation_z(np.radians(40.0 * camera)), [1.5, 0.1 * camera, 2.1]
    )


def street_from_ego(seconds: float) -> np.ndarray:
    """The vehicle frame at a time."""
    return se3.from_rotation_translation(np.eye(3), [SPEED * seconds, 0.0, 0.0])


def street_from_car(seconds: float) -> np.ndarray:
    """A car ahead, turned and drifting so that every axis shows."""
    return se3.from_rotation_translation(
        se3.rotation_z(np.radians(20.0)), [18.0 + 9.0 * seconds, 1.0, CAR_SIZE[2] / 2]
    )


def pixel_of(street: np.ndarray, seconds: float, camera: int) -> np.ndarray:
    """Pixel of a point of the street by Waymo's own camera model."""
    mounted = street_from_ego(seconds) @ vehicle_from_waymo_camera(camera)
    x, y, z, _ = np.linalg.inv(mounted) @ np.append(street, 1.0)
    fu, fv, cu, cv, k1, k2, p1, p2, k3 = INTRINSIC
    u, v = -y / x, -z / x
    r2 = u * u + v * v
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u_bent = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    v_bent = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
    return np.array([fu * u_bent + cu, fv * v_bent + cv])


def write_street_gaussians(root: Path) -> Path:
    """The scene as Street Gaussians has it, with its points as plain arrays; returns its folder."""
    scene = root / SCENE
    times: dict[str, dict[str, float]] = {"FRAME": {}, "FRONT": {}, "FRONT_LEFT": {}}
    lines = ["frame_id track_id object_class alpha h w l cx cy cz heading speed"]
    points = {}
    for k in range(FRAMES):
        began, time = 0.1 * k, 0.1 * k + FRAME_DELAY
        write_matrix(scene / f"ego_pose/{k:06d}.txt", GLOBAL_FROM_STREET @ street_from_ego(time))
        times["FRAME"][f"{k:06d}"] = START + began
        for camera, delay in CAMERA_DELAY.items():
            pose = GLOBAL_FROM_STREET @ street_from_ego(began + delay)
            write_matrix(scene / f"ego_pose/{k:06d}_{camera}.txt", pose)
            times[CAMERA_NAMES[camera]][f"{k:06d}"] = START + began + delay
            _write_image(scene / f"images/{k:06d}_{camera}.png", began + delay, camera)
        lines += _track_lines(k, time)
        points[f"{k:06d}"] = points_in_vehicle(time).astype(np.float32)
    opencv = np.eye(4)
    opencv[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    _write_calibration(scene, {c: vehicle_from_waymo_camera(c) @ opencv for c in CAMERA_DELAY})
    (scene / "timestamps.json").write_text(json.dumps(times))
    (scene / "track").mkdir()
    (scene / "track/track_info.txt").write_text("\n".join(lines) + "\n")
    np.savez(scene / "pointcloud.npz", **points)
    return scene


def write_drivestudio(root: Path) -> Path:
    """The scene as DriveStudio has it: everything at the frames' times; returns its folder."""
    scene = root / SCENE
    (scene / "lidar").mkdir(parents=True)
    boxes: dict[str, list] = {"frame_idx": [], "obj_to_world": [], "box_size": []}
    for k in range(FRAMES):
        time = 0.1 * k
        write_matrix(scene / f"ego_pose/{k:03d}.txt", GLOBAL_FROM_STREET @ street_from_ego(time))
        for camera in CAMERA_DELAY:
            _write_image(scene / f"images/{k:03d}_{camera}.jpg", time, camera)
        lidar_rows(time).astype("<f4").tofile(scene / f"lidar/{k:03d}.bin")
        if k >= 2:  # seen later
            boxes["frame_idx"].append(k)
            boxes["obj_to_world"].append((GLOBAL_FROM_STREET @ street_from_car(time)).tolist())
            boxes["box_size"].append(CAR_SIZE.tolist())
    _write_calibration(scene, {c: vehicle_from_waymo_camera(c) for c in CAMERA_DELAY})
    nothing: dict[str, list] = {"frame_idx": [], "obj_to_world": [], "box_size": []}
    instances = {
        "0": {"id": "a1", "class_name": "Vehicle", "frame_annotations": boxes},
        "1": {"id": "b2", "class_name": "Cyclist", "frame_annotations": nothing},
    }
    (scene / "instances").mkdir()
    (scene / "instances/instances_info.json").write_text(json.dumps(instances))
    # A pickle lies in the original too; nobody opens it.
    (scene / "humanpose").mkdir()
    (scene / "humanpose/smpl.pkl").write_bytes(b"cos\nsystem\n(S'false'\ntR.")
    return scene


def points_in_vehicle(seconds: float) -> np.ndarray:
    """Points (LASER_POINTS, 3) inside the car, vehicle frame."""
    generator = np.random.default_rng(round(seconds * 1e6))
    in_box = (generator.random((LASER_POINTS, 3)) - 0.5) * (CAR_SIZE - 0.2)
    vehicle_from_car = se3.inverse(street_from_ego(seconds)) @ street_from_car(seconds)
    return se3.apply(vehicle_from_car, in_box)


def lidar_rows(seconds: float) -> np.ndarray:
    """DriveStudio's rows (N, 14): the car's points, seen by the top and by the rear scanner."""
    rows = np.zeros((len(LASERS), LASER_POINTS, 14))
    for row, (number, place) in zip(rows, LASERS.items(), strict=True):
        row[:, 0:3], row[:, 3:6], row[:, 13] = place, points_in_vehicle(seconds), number
        row[:, 11] = np.linspace(0.0, 5.0, LASER_POINTS)
    return rows.reshape(-1, 14)


def write_matrix(path: Path, matrix: np.ndarray) -> None:
    """Numbers, a row a line."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, matrix)


def _track_lines(frame: int, seconds: float) -> list[str]:
    pose = se3.inverse(street_from_ego(seconds)) @ street_from_car(seconds)
    length, width, height = CAR_SIZE
    place = " ".join(str(value) for value in pose[:3, 3].tolist())
    heading = float(se3.yaw(pose))
    return [
        f"{frame} 7 vehicle 0 {height} {width} {length} {place} {heading} 9.0",
        f"{frame} 8 sign 0 1 1 1 5 5 2 0 0.0",
    ]


def _write_calibration(scene: Path, extrinsics: dict[int, np.ndarray]) -> None:
    for camera, extrinsic in extrinsics.items():
        write_matrix(scene / f"extrinsics/{camera}.txt", extrinsic)
        write_matrix(scene / f"intrinsics/{camera}.txt", np.array(INTRINSIC))


def _write_image(path: Path, seconds: float, camera: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.full((HEIGHT, WIDTH, 3), 20, np.uint8)
    column, row = np.floor(pixel_of(LAMP, seconds, camera)).astype(int)  # pixel 0 covers [0, 1)
    if 2 < column < WIDTH - 3 and 2 < row < HEIGHT - 3:
        pixels[row - 2 : row + 3, column - 2 : column + 3] = 250
    Image.fromarray(pixels).save(path, **({"quality": 95} if path.suffix == ".jpg" else {}))
