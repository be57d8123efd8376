"""A small Argoverse 2 sensor log in the dataset's own layout, written from nothing.

The ego drives 30 degrees north of east in a city far from its origin. Everything is told in the
street's frame: x along the road, z up, origin on the ground under the ego's first rear axle.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
from PIL import Image
from pyarrow import feather

from recast.geometry import se3

LOG = "11111111-2222-3333-4444-555555555555"
START_NS = 315966253_000_000_000
SECONDS, POSE_NS, SWEEP_NS = 2.0, 10_000_000, 100_000_000
SPEED = 5.0
AXLE_HEIGHT = 0.32
CITY_FROM_STREET = se3.from_rotation_translation(
    se3.rotation_z(np.radians(30.0)), [1000.0, 2000.0, 60.0]
)
CAR_SIZE = np.array([4.0, 1.8, 1.5])
CAR_POINTS = 40
LABEL_NS = 54_000_000
"""After the sweep's time, when its boxes are where they are said to be."""
SEEN_NS = {"up_lidar": 85_000_000, "down_lidar": 35_000_000}
"""After the sweep's time, when each scanner meets the car."""
WIDTH, HEIGHT = 24, 32
"""Of the front camera, which stands upright; of the others the other way round."""
CAMERA_NS = 50_000_000
SIDE_NS = 23_000_000
"""From an image of the front camera to the next of the one at the side."""
FORWARD = se3.from_rotation_translation(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), [1.6, 0.0, 1.4]
)
DOWN = se3.from_rotation_translation(np.diag([1.0, -1.0, -1.0]), [1.35, 0.0, 1.5])
UP = se3.from_rotation_translation(np.eye(3), [1.35, 0.0, 1.64])
CELL = 0.5


def street_from_ego(seconds: float | np.ndarray) -> np.ndarray:
    """True poses (..., 4, 4) of the dataset's ego frame: the rear axle, above the ground."""
    seconds = np.asarray(seconds, np.float64)
    place = np.stack(np.broadcast_arrays(SPEED * seconds, 0.0, AXLE_HEIGHT), axis=-1)
    return se3.from_rotation_translation(np.eye(3), place)


def street_from_car(seconds: float) -> np.ndarray:
    """A car ahead, on the ground, turned and drifting so that every axis shows."""
    return se3.from_rotation_translation(
        se3.rotation_z(np.radians(20.0)), [15.0 + 10.0 * seconds, 1.0, CAR_SIZE[2] / 2]
    )


def write_tiny_log(root: Path, split: str = "val") -> Path:
    """Write the log `LOG` under `root`; returns its folder."""
    folder = root / split / LOG
    _write_poses(folder)
    _write_boxes(folder)
    _write_sensors(folder)
    _write_map(folder / "map")
    return folder


def write_table(path: Path, **columns: object) -> None:
    """A feather file of columns."""
    path.parent.mkdir(parents=True, exist_ok=True)
    feather.write_feather(pa.table(columns), str(path))


def edit_table(path: Path, **changes: object) -> None:
    """Replace columns, or remove those that become None."""
    table = feather.read_table(path, memory_map=False)
    columns = {name: table[name] for name in table.column_names} | changes
    write_table(path, **{name: column for name, column in columns.items() if column is not None})


def _pose_columns(poses: np.ndarray) -> dict[str, np.ndarray]:
    values = np.concatenate([se3.matrix_to_quat(poses[:, :3, :3]), poses[:, :3, 3]], axis=1)
    return dict(zip(("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"), values.T, strict=True))


def _write_poses(folder: Path) -> None:
    times = START_NS + np.arange(0, int(SECONDS * 1e9) + 1, POSE_NS)
    times = np.insert(times, 5, times[5] - 1)  # two clocks: some poses are a nanosecond apart
    poses = CITY_FROM_STREET @ street_from_ego((times - START_NS) / 1e9)
    write_table(folder / "city_SE3_egovehicle.feather", timestamp_ns=times, **_pose_columns(poses))


def _write_boxes(folder: Path) -> None:
    rows = []
    for time in np.arange(0, int(SECONDS * 1e9) + 1, SWEEP_NS):
        ego_from_street = se3.inverse(street_from_ego(time / 1e9))
        bicycle = se3.from_rotation_translation(np.eye(3), [20.0, 4.0, 0.5])
        for track, category, size, pose in (
            ("ego", "EGO_VEHICLE", (4.9, 2.0, 1.5), se3.inverse(ego_from_street)),
            ("car", "REGULAR_VEHICLE", CAR_SIZE, street_from_car((time + LABEL_NS) / 1e9)),
            ("bike", "BICYCLE", (1.6, 0.6, 1.0), bicycle),
        ):
            rows.append((START_NS + time, track, category, size, ego_from_street @ pose))
    times, tracks, categories, sizes, poses = zip(*rows, strict=True)
    write_table(
        folder / "annotations.feather",
        timestamp_ns=np.array(times),
        track_uuid=list(tracks),
        category=list(categories),
        **dict(zip(("length_m", "width_m", "height_m"), np.array(sizes, float).T, strict=True)),
        **_pose_columns(np.stack(poses)),
        num_interior_pts=np.full(len(rows), CAR_POINTS),
    )


def _write_sensors(folder: Path) -> None:
    write_table(
        folder / "calibration" / "intrinsics.feather",
        sensor_name=["ring_front_center", "ring_side_left", "stereo_front_left"],
        **{name: np.array([30.0, 32.0, 31.0]) for name in ("fx_px", "fy_px")},
        cx_px=np.array([11.5, 15.5, 15.5]),
        cy_px=np.array([15.5, 11.5, 11.5]),
        **{name: np.full(3, -0.2) for name in ("k1", "k2", "k3")},
        height_px=np.array([HEIGHT, WIDTH, WIDTH], np.uint16),
        width_px=np.array([WIDTH, HEIGHT, HEIGHT], np.uint16),
    )
    write_table(
        folder / "calibration" / "egovehicle_SE3_sensor.feather",
        sensor_name=[
            "ring_front_center",
            "ring_side_left",
            "stereo_front_left",
            "up_lidar",
            "down_lidar",
        ],
        **_pose_columns(np.stack([FORWARD, FORWARD, FORWARD, UP, DOWN])),
    )
    for camera, size, after in (
        ("ring_front_center", (WIDTH, HEIGHT), 216),
        ("ring_side_left", (HEIGHT, WIDTH), 216 + SIDE_NS),
    ):
        images = folder / "sensors" / "cameras" / camera
        images.mkdir(parents=True)
        for k in range(10):
            # Camera times are not those of sweeps, and the last image comes after the last pose.
            time = START_NS + after + k * CAMERA_NS + (0 if k < 9 else int(1.9e9))
            picture = Image.new("RGB", size, (20 * k, 100, 200))
            picture.save(images / f"{time}.jpg", quality=95)
    for k in (3, 4):
        _write_sweep(folder / "sensors" / "lidar", k * SWEEP_NS)


def car_points(time: int) -> np.ndarray:
    """Points (CAR_POINTS, 3) that a sweep meets on the car, in its own frame."""
    generator = np.random.default_rng(time)
    return (generator.random((CAR_POINTS, 3)) - 0.5) * (CAR_SIZE - 0.2)


def _write_sweep(folder: Path, time: int) -> None:
    """40 points on the car and 200 on the road, every second one from the same LiDAR.

    The ego motion is undone, that of the car is not: each scanner meets it at its own place.
    """
    generator = np.random.default_rng(time)
    road = np.column_stack(
        [generator.uniform(-20, 30, 200), generator.uniform(-6, -3, 200), np.zeros(200)]
    )
    count = CAR_POINTS + len(road)
    from_down = np.arange(count) % 2 == 1
    offset = np.linspace(2_654_000, 106_000_000, count).astype(np.int32)
    offset[1:CAR_POINTS] = np.where(from_down, SEEN_NS["down_lidar"], SEEN_NS["up_lidar"])[
        1:CAR_POINTS
    ]
    car = [
        se3.apply(street_from_car((time + after) / 1e9), point[None])[0]
        for point, after in zip(car_points(time), offset.tolist(), strict=False)
    ]
    street = np.concatenate([car, road])
    points = se3.apply(se3.inverse(street_from_ego(time / 1e9)), street).astype(np.float16)
    write_table(
        folder / f"{START_NS + time}.feather",
        **{axis: points[:, i] for i, axis in enumerate("xyz")},
        intensity=np.arange(count).astype(np.uint8),
        laser_number=np.where(from_down, 40, 7).astype(np.uint8),
        offset_ns=offset,
    )


def _city(points: list[tuple[float, float]]) -> list[dict[str, float]]:
    street = np.array([(x, y, 0.0) for x, y in points])
    return [
        dict(zip("xyz", row, strict=True)) for row in se3.apply(CITY_FROM_STREET, street).tolist()
    ]


def _segment(key: int, left: list, right: list, **changes: object) -> tuple[str, dict]:
    return str(key), {
        "id": key,
        "is_intersection": False,
        "lane_type": "VEHICLE",
        "left_lane_boundary": _city(left),
        "left_lane_mark_type": "NONE",
        "right_lane_boundary": _city(right),
        "right_lane_mark_type": "NONE",
        "successors": [],
        "predecessors": [],
        "left_neighbor_id": None,
        "right_neighbor_id": None,
        **changes,
    }


def _write_map(folder: Path) -> None:
    """The ego's lane 1 leads to 2; beside it 3 (same way), 4 (oncoming), and a bicycle lane 5."""
    folder.mkdir(parents=True)
    middle = [(-10.0, 2.0), (5.0, 2.0), (30.0, 2.0)]
    lanes = [
        _segment(
            1,
            middle,
            [(-10.0, -2.0), (30.0, -2.0)],
            successors=[2, 99],
            left_neighbor_id=4,
            right_neighbor_id=3,
        ),
        _segment(2, [(30.0, 2.0), (60.0, 2.0)], [(30.0, -2.0), (60.0, -2.0)], is_intersection=True),
        _segment(
            3,
            [(-10.0, -2.0), (30.0, -2.0)],
            [(-10.0, -6.0), (30.0, -6.0)],
            lane_type="BUS",
            left_neighbor_id=1,
            right_neighbor_id=5,
            successors=[5],
        ),
        _segment(4, middle[::-1], [(30.0, 6.0), (-10.0, 6.0)], left_neighbor_id=1),
        _segment(
            5,
            [(-10.0, -6.0), (30.0, -6.0)],
            [(-10.0, -8.0), (30.0, -8.0)],
            lane_type="BIKE",
            left_neighbor_id=3,
        ),
    ]
    outline = _city([(-10, -8), (60, -8), (60, 6), (-10, 6)])
    write_json(
        folder / f"log_map_archive_{LOG}____PIT_city_1.json",
        {
            "pedestrian_crossings": {},
            "lane_segments": dict(lanes),
            "drivable_areas": {"7": {"area_boundary": outline, "id": 7}},
        },
    )
    corner = np.array([980.0, 1980.0])
    rows, columns = np.mgrid[0:200, 0:160]
    height = (60.0 + 0.01 * columns + 0.02 * rows).astype(np.float16)
    height[0, 0] = np.nan
    np.save(folder / f"{LOG}_ground_height_surface____PIT.npy", height)
    write_json(
        folder / f"{LOG}___img_Sim2_city.json",
        {"R": [1.0, 0.0, 0.0, 1.0], "t": (-corner).tolist(), "s": 1 / CELL},
    )


def write_json(path: Path, value: object) -> None:
    """Any JSON value."""
    path.write_text(json.dumps(value))
