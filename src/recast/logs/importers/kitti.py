"""KITTI raw: one synchronised and rectified drive as a driving log.

Sensors keep their own timestamps, less the delay of the images. Sweeps as recorded are smeared by
the ego motion of one turn: every point gets the time at which the scanner pointed at it, and the
motion is undone (docs/data.md has the measurements).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import motion
from recast.logs.derive_map import derive_map, ego_path
from recast.logs.images import ImageFiles
from recast.logs.importers import kitti_files
from recast.logs.importers.common import IMAGES, chosen_cameras, first_jump, returns_valid
from recast.logs.importers.kitti_files import (
    KittiCalibration,
    KittiDrive,
    SensorFiles,
    read_calibration,
)
from recast.logs.importers.kitti_labels import check_labels_fit, place_tracks, read_labels
from recast.logs.importers.kitti_sensors import (
    VelodyneSweeps,
    VelodyneTurns,
    list_turns,
    poses_from_oxts,
    read_oxts,
    turn_times,
)
from recast.logs.refine_trajectory import heading_offset, refine_trajectory
from recast.logs.types import (
    Array,
    CameraStream,
    DrivingLog,
    Int64Array,
    LidarStream,
    Trajectory,
)

VELODYNE = "velodyne"
GREY = ("image_00", "image_01")
COLOUR = ("image_02", "image_03")
LONGEST_DELAY_US = 100_000  # a turn of the scanner
LICENCE = "CC BY-NC-SA 3.0"


def load_kitti(
    root: Path,
    drive: str,
    labels: Path | None = None,
    cameras: Sequence[str] = (),
    refine: bool = True,
    with_map: bool = True,
) -> DrivingLog:
    """Read a KITTI raw drive; images and sweeps are decoded when asked for.

    Args:
        root: folder that holds the day folders ("2011_09_26").
        drive: "2011_09_26_drive_0013", with or without "_sync".
        labels: a KITTI tracking label file (.txt) or tracklet_labels.xml; None for the drive's own
            tracklet_labels.xml, if there is one.
        cameras: image folders to read; if empty, image_02 and image_03, as far as they are there,
            because a scene cannot learn colours from the grey images of image_00 and image_01.
        refine: correct the GPS/IMU poses by matching sweeps; without it, static objects are smeared
            by decimetres.
        with_map: derive a map from the drive (see `derive_map`), which takes seconds.

    Raises:
        InputError: files are missing, broken or do not belong together.
    """
    log = _read(root, drive, labels, cameras, refine)
    if with_map and ego_path(log.world_from_rig) is not None:
        return replace(log, map=derive_map(log))
    return log


@returns_valid
def _read(
    root: Path, drive: str, labels: Path | None, cameras: Sequence[str], refine: bool
) -> DrivingLog:
    """The drive without a map."""
    files = kitti_files.find_drive(Path(root), drive)
    taken = _cameras(files, cameras)
    calibration = read_calibration(files.calibration, taken)
    turns = list_turns(files.folder / "velodyne_points")
    times = turn_times(files.folder / "velodyne_points")
    images = {name: _image_files(files.folder / name, times[0]) for name in taken}
    # What can be found wrong in the files is found before the long work.
    sources = {
        name: _image_source(calibration.cameras[name], listed.paths)
        for name, listed in images.items()
    }
    for source in sources.values():
        source.check()
    own = files.folder / "tracklet_labels.xml"
    chosen = Path(labels) if labels is not None else own if own.is_file() else None
    labelled = [] if chosen is None else read_labels(chosen, len(times[0]))
    covered = (
        min(turns.start_us[0], *(listed.timestamps_us[0] for listed in images.values())),
        max(turns.end_us[-1], *(listed.timestamps_us[-1] for listed in images.values())),
    )
    trajectory, offset = _ego(files, calibration, covered)
    if refine:
        trajectory = refine_trajectory(_lidar(calibration, turns, trajectory), trajectory)
        yaw = heading_offset(trajectory)
        turned = se3.from_rotation_translation(se3.rotation_z(yaw), np.zeros(3))
        trajectory = replace(trajectory, poses=trajectory.poses @ turned)
        calibration = calibration.seen_from(se3.inverse(turned))
    log = DrivingLog(
        name=files.name,
        cameras={
            name: _camera(name, calibration, listed, sources[name], trajectory)
            for name, listed in images.items()
        },
        lidars={VELODYNE: _lidar(calibration, turns, trajectory)},
        world_from_rig=trajectory,
        tracks={},
        world_offset=offset,
        metadata={
            "dataset": "KITTI raw",
            "drive": files.name,
            "licence": LICENCE,
            "poses": "OXTS refined by LiDAR" if refine else "OXTS",
        },
    )
    if chosen is None:
        return log
    tracks = place_tracks(labelled, chosen, times, calibration, trajectory)
    check_labels_fit(log, tracks, chosen)
    return replace(log, tracks=tracks)


def _cameras(files: KittiDrive, named: Sequence[str]) -> tuple[str, ...]:
    """The cameras to take: those named, or else all with colours, or else all."""
    found = [name for name in GREY + COLOUR if (files.folder / name).is_dir()]
    if not found:
        mend = "unpack the drive's images beside its velodyne_points"
        raise InputError(files.folder, "cameras", "image_00 to image_03 are missing", mend)
    coloured = [name for name in found if name in COLOUR]
    return tuple(chosen_cameras(files.folder, found, named or coloured))


def _image_files(folder: Path, trigger_us: Int64Array) -> SensorFiles:
    listed = kitti_files.list_frames(folder, *IMAGES)
    if listed.indices[-1] >= len(trigger_us):
        return listed
    # The scanner triggers the shutter as it faces forward; the images' stamps come about 10 ms
    # later, at the host. Images and sweeps match best (docs/data.md) without that delay.
    delay = int(np.median(listed.timestamps_us - trigger_us[listed.indices]))
    if abs(delay) > LONGEST_DELAY_US:
        problem = f"are {delay / 1e6:.3f} s after the scanner's triggers of the same frames"
        mend = "use sensors of the same drive"
        raise InputError(folder / "timestamps.txt", "times", problem, mend)
    return replace(listed, timestamps_us=listed.timestamps_us - delay)


def _ego(
    files: KittiDrive, calibration: KittiCalibration, covered: tuple[int, int]
) -> tuple[Trajectory, Array]:
    """The ego trajectory (of the rig frame, near the origin) and the offset taken off it."""
    listed = kitti_files.list_frames(files.folder / "oxts", ".txt")
    world_from_imu = poses_from_oxts(read_oxts(listed))
    jump = first_jump(listed.timestamps_us, world_from_imu)
    if jump is not None:
        problem = f"is {jump[1]:.0f} m from the packet before it"
        raise InputError(listed.paths[jump[0]], "position", problem, "download it again")
    poses = world_from_imu @ se3.inverse(calibration.rig_from_imu)
    offset = poses[0, :3, 3].copy()
    poses[:, :3, 3] -= offset
    return motion.extended(Trajectory(listed.timestamps_us, poses), *covered), offset


def _camera(
    name: str,
    calibration: KittiCalibration,
    listed: SensorFiles,
    source: ImageFiles,
    trajectory: Trajectory,
) -> CameraStream:
    kept = [i for i, time in enumerate(listed.timestamps_us) if trajectory.covers(int(time))]
    _require(kept, listed.paths)
    return CameraStream(
        name=name,
        camera=calibration.cameras[name],
        rig_from_camera=calibration.rig_from_camera[name],
        timestamps_us=listed.timestamps_us[kept],
        images=replace(source, paths=tuple(listed.paths[i] for i in kept)),
    )


def _require(kept: Sequence[int], paths: Sequence[Path]) -> None:
    if not kept:
        problem = "no frame lies within the times of the OXTS poses"
        mend = "use sensors and poses of the same drive"
        raise InputError(paths[0].parents[1], "timestamps.txt", problem, mend)


def _image_source(camera: PinholeCamera, paths: tuple[Path, ...]) -> ImageFiles:
    return ImageFiles(paths, camera.width, camera.height, "calib_cam_to_cam.txt")


def _lidar(
    calibration: KittiCalibration, turns: VelodyneTurns, trajectory: Trajectory
) -> LidarStream:
    kept = [
        i
        for i in range(len(turns.paths))
        if trajectory.covers(int(turns.start_us[i])) and trajectory.covers(int(turns.end_us[i]))
    ]
    _require(kept, turns.paths)
    kept_turns = turns.select(kept)
    mount = calibration.rig_from_velodyne
    return LidarStream(
        VELODYNE, mount, kept_turns.trigger_us, VelodyneSweeps(kept_turns, mount, trajectory)
    )
