"""A small drive in KITTI raw layout, written from nothing.

The ego drives straight at 8 m/s through the street of `tiny_world`; the sensors sit, are timed and
are calibrated as on KITTI's car, slightly turned so that a forgotten rotation shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from recast.geometry import se3
from support import tiny_world

DATE = "2011_09_26"
DRIVE = "2011_09_26_drive_9999"
FRAMES = 24
LISTED = 30  # lines of the timestamp files; files end earlier, as in a cut drive
STEP = 0.1
EGO_SPEED = 8.0
STREET_HEADING = np.radians(30.0)  # of the street's x axis, from east
LATITUDE, LONGITUDE, ALTITUDE = 49.01, 8.43, 112.0
EARTH_RADIUS = 6378137.0
WIDTH, HEIGHT, FOCAL, CX, CY = 160, 48, 110.0, 79.5, 19.0
CAMERA_DELAY, OXTS_DELAY, HALF_TURN = 0.010, 0.017, 0.050  # the image is taken at the trigger
RINGS, COLUMNS = 32, 450
UNLABELLED = (6, 7)  # frames without labels, as KITTI has
IMU_HEIGHT, IMU_BEHIND_AXLE = 0.93, 0.05


def _yaw(degrees: float) -> np.ndarray:
    return se3.rotation_z(np.radians(degrees))


VELODYNE_FROM_IMU = se3.from_rotation_translation(_yaw(0.4), [-0.81, 0.32, -0.80])
_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # camera from velodyne
CAMERA_FROM_VELODYNE = se3.from_rotation_translation(_AXES @ _yaw(0.3), [0.0, -0.08, -0.27])
RECTIFICATION = se3.from_rotation_translation(
    _AXES @ _yaw(-0.7) @ _AXES.T, [0.0, 0.0, 0.0]
)  # together: the cameras look straight ahead
BASELINE = np.array([0.06, 0.0, 0.003])  # camera 2 from rectified camera 0
RIG_FROM_IMU = se3.from_rotation_translation(
    np.eye(3), [-IMU_BEHIND_AXLE, VELODYNE_FROM_IMU[1, 3], IMU_HEIGHT]
)
RIG_FROM_VELODYNE = RIG_FROM_IMU @ se3.inverse(VELODYNE_FROM_IMU)
RECTIFIED_FROM_RIG = RECTIFICATION @ CAMERA_FROM_VELODYNE @ se3.inverse(RIG_FROM_VELODYNE)


@dataclass(frozen=True)
class TinyDrive:
    """What was written.

    Attributes:
        root: KITTI folder; the drive is `DRIVE`.
        labels: tracking label file.
    """

    root: Path
    labels: Path

    @property
    def folder(self) -> Path:
        """The drive's own folder."""
        return self.root / DATE / f"{DRIVE}_sync"


def street_from_rig(seconds: np.ndarray) -> np.ndarray:
    """True ego poses (..., 4, 4)."""
    seconds = np.asarray(seconds, np.float64)
    place = np.zeros((*seconds.shape, 3))
    place[..., 0] = EGO_SPEED * seconds
    return se3.from_rotation_translation(np.eye(3), place)


def write_tiny_drive(root: Path) -> TinyDrive:
    """Write the drive under `root`; takes about a second."""
    drive = TinyDrive(root, root / "labels.txt")
    _write_calibration(root / DATE)
    starts = STEP * np.arange(LISTED)
    for sensor, delay in (("velodyne_points", 0.0), ("image_02", CAMERA_DELAY)):
        _write_times(drive.folder / sensor / "timestamps.txt", starts + delay)
    _write_times(drive.folder / "oxts" / "timestamps.txt", starts + OXTS_DELAY)
    for name, shift in (("start", -HALF_TURN), ("end", HALF_TURN)):
        path = drive.folder / "velodyne_points" / f"timestamps_{name}.txt"
        _write_times(path, starts + shift)
    rng = np.random.default_rng(0)
    for frame in range(FRAMES):
        name = f"{frame:010d}"
        _write_oxts(drive.folder / "oxts" / "data" / f"{name}.txt", starts[frame] + OXTS_DELAY)
        _write_image(drive.folder / "image_02" / "data" / f"{name}.png", starts[frame])
        if frame % 2 == 0:
            path = drive.folder / "velodyne_points" / "data" / f"{name}.bin"
            _write_sweep(path, starts[frame], rng)
    write_tracking_labels(drive.labels)
    return drive


def _write_calibration(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    K = np.array([[FOCAL, 0.0, CX], [0.0, FOCAL, CY], [0.0, 0.0, 1.0]])
    lines = ["calib_time: 09-Jan-2012 13:57:47", f"R_rect_00: {_row(RECTIFICATION[:3, :3])}"]
    for number, shift in (("00", np.zeros(3)), ("02", BASELINE)):
        lines.append(f"S_rect_{number}: {_row(np.array([WIDTH, HEIGHT]))}")
        lines.append(f"P_rect_{number}: {_row(np.column_stack([K, K @ shift]))}")
    (folder / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")
    for name, pose in (("velo_to_cam", CAMERA_FROM_VELODYNE), ("imu_to_velo", VELODYNE_FROM_IMU)):
        text = (
            f"calib_time: 25-May-2012 16:47:16\nR: {_row(pose[:3, :3])}\nT: {_row(pose[:3, 3])}\n"
        )
        (folder / f"calib_{name}.txt").write_text(text)


def _row(values: np.ndarray) -> str:
    return " ".join(f"{value:e}" for value in np.ravel(values))


def _write_times(path: Path, seconds: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    start = np.datetime64("2011-09-26T13:02:25.964389445", "ns")
    times = start + np.rint(seconds * 1e9).astype("timedelta64[ns]")
    path.write_text("\n".join(str(time).replace("T", " ") for time in times) + "\n")


def _write_oxts(path: Path, seconds: float) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    turned = se3.from_rotation_translation(se3.rotation_z(STREET_HEADING), np.zeros(3))
    imu = turned @ street_from_rig(seconds) @ RIG_FROM_IMU
    scale = np.cos(np.radians(LATITUDE))
    first_north = np.log(np.tan(np.pi / 4 + np.radians(LATITUDE) / 2)) * EARTH_RADIUS * scale
    north = (first_north + imu[1, 3]) / (scale * EARTH_RADIUS)
    latitude = np.degrees(2 * np.arctan(np.exp(north)) - np.pi / 2)
    longitude = LONGITUDE + np.degrees(imu[0, 3] / (scale * EARTH_RADIUS))
    values = np.zeros(30)
    values[:6] = latitude, longitude, ALTITUDE + imu[2, 3], 0.0, 0.0, STREET_HEADING
    values[8] = EGO_SPEED
    path.write_text(" ".join(f"{value:.15g}" for value in values) + "\n")


def _write_image(path: Path, start: float) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    offsets = (np.arange(2 * WIDTH) / 2 - 0.25, np.arange(2 * HEIGHT) / 2 - 0.25)
    u, v = np.meshgrid(*offsets)  # four rays a pixel, KITTI counts centres from 0
    rays = np.stack([(u - CX) / FOCAL, (v - CY) / FOCAL, np.ones_like(u)], axis=-1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    camera_from_rectified = se3.from_rotation_translation(np.eye(3), BASELINE)
    rig_from_camera = se3.inverse(camera_from_rectified @ RECTIFIED_FROM_RIG)
    pose = street_from_rig(start) @ rig_from_camera
    origins = np.broadcast_to(pose[:3, 3], rays.shape)
    _, colours = tiny_world.cast(origins, rays @ pose[:3, :3].T, np.full(len(rays), start))
    pixels = colours.reshape(HEIGHT, 2, WIDTH, 2, 3).mean(axis=(1, 3))
    Image.fromarray(np.clip(np.rint(pixels), 0, 255).astype(np.uint8)).save(path)


def _write_sweep(path: Path, trigger: float, rng: np.random.Generator) -> None:
    """A turn of the scanner while ego and car move: points in the sensor frame as measured."""
    path.parent.mkdir(parents=True, exist_ok=True)
    elevation = np.radians(np.linspace(2.0, -24.8, RINGS))
    azimuth = np.pi - 2 * np.pi * (np.arange(COLUMNS) + 0.5) / COLUMNS
    azimuth, elevation = (a.ravel() for a in np.meshgrid(azimuth, elevation))
    rays = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=-1,
    )
    seconds = trigger - azimuth / (2 * np.pi) * 2 * HALF_TURN
    poses = street_from_rig(seconds) @ RIG_FROM_VELODYNE
    directions = np.einsum("nij,nj->ni", poses[:, :3, :3], rays)
    distance, colours = tiny_world.cast(poses[:, :3, 3], directions, seconds)
    hit = distance < 70.0
    measured = distance + rng.normal(0.0, 0.005, len(distance))
    points = np.column_stack([rays * measured[:, None], colours.mean(axis=1) / 255.0])[hit]
    points.astype(np.float32).tofile(path)


def _boxes() -> list[tuple[int, int, str, np.ndarray]]:
    """Frame, track, type and box centre (3,) in the rig frame at the time the scanner met it."""
    rows = []
    for frame in range(FRAMES):
        for track, kind in ((0, "Car"), (1, "Van")):
            seconds = STEP * frame
            for _ in range(3):  # the time depends on the place and the place on the time
                street = tiny_world.parked_centre() if track else tiny_world.car_centre(seconds)
                centre = se3.apply(se3.inverse(street_from_rig(seconds)), street[None])[0]
                seen = se3.apply(se3.inverse(RIG_FROM_VELODYNE), centre[None])[0]
                seconds = STEP * frame - np.arctan2(seen[1], seen[0]) / np.pi * HALF_TURN
            if seen[0] > 3.0 and frame not in UNLABELLED:
                rows.append((frame, track, kind, centre))
    return rows


def write_tracking_labels(path: Path) -> None:
    """Write the boxes as a KITTI tracking label file."""
    length, width, height = tiny_world.CAR_SIZE
    heading = RECTIFIED_FROM_RIG[:3, 0]  # of the street, in the rectified camera
    turn = np.arctan2(-heading[2], heading[0])
    lines = []
    for frame, track, kind, centre in _boxes():
        x, y, z = se3.apply(RECTIFIED_FROM_RIG, centre[None])[0] + [0.0, height / 2, 0.0]
        box = f"{height} {width} {length} {x:.6f} {y:.6f} {z:.6f} {turn:.6f}"
        lines.append(f"{frame} {track} {kind} 0 0 0 0 0 10 10 {box}")
        lines.append(f"{frame} -1 DontCare -1 -1 -10 1 1 5 5 -1000 -1000 -1000 -10 -1 -1 -1")
    path.write_text("\n".join(lines) + "\n")


def write_tracklets(path: Path) -> None:
    """Write the moving car's boxes of the frames before the unlabelled ones as tracklets."""
    length, width, height = tiny_world.CAR_SIZE
    velodyne_from_rig = se3.inverse(RIG_FROM_VELODYNE)
    yaw = se3.yaw(velodyne_from_rig)
    poses = []
    for frame, track, _, centre in _boxes():
        if track == 0 and frame < min(UNLABELLED):
            x, y, z = se3.apply(velodyne_from_rig, centre[None])[0] - [0.0, 0.0, height / 2]
            poses.append(
                f"<item><tx>{x:.6f}</tx><ty>{y:.6f}</ty><tz>{z:.6f}</tz>"
                f"<rx>0</rx><ry>0</ry><rz>{yaw:.6f}</rz><state>1</state></item>"
            )
    path.write_text(
        '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<boost_serialization>'
        f"<tracklets><count>1</count><item_version>1</item_version><item>"
        f"<objectType>Car</objectType><h>{height}</h><w>{width}</w><l>{length}</l>"
        f"<first_frame>0</first_frame><poses><count>{len(poses)}</count>{''.join(poses)}</poses>"
        "<finished>1</finished></item></tracklets></boost_serialization>\n"
    )
