"""What the rig's sensors measure at each moment of a world's log, written to files.

Every measurement has random numbers of its own, by seed, sensor and frame, so that it does not
matter in which order and by whom they are made.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from recast.geometry import se3
from recast.logs import LidarSweep
from recast.synthetic.oracle import Oracle
from recast.synthetic.rendering import WAYMO_TOP, scan_lidar
from recast.synthetic.rig import LIDAR, Rig, RigCamera, exposure, sensor_number
from recast.synthetic.truth import write_truth_frame

Image = NDArray[np.uint8]

_CAMERA_STREAM, _LIDAR_STREAM = 201, 202


@dataclass(frozen=True)
class Measurement:
    """One image or sweep to be made.

    Attributes:
        sensor: a camera's name, or `LIDAR`.
        frame: which moment of the log.
        timestamp_us: of it.
        rig: the sensors.
        spool: folder for images and sweeps, with a folder for each sensor.
        truth: folder for depth and instances, or None.
    """

    sensor: str
    frame: int
    timestamp_us: int
    rig: Rig
    spool: Path
    truth: Path | None = None


def measure(oracle: Oracle, job: Measurement) -> tuple[int, ...]:
    """Make one measurement and write its files; returns the instances seen."""
    if job.sensor == LIDAR:
        return _scan(oracle, job)
    return _photograph(oracle, job, job.rig.cameras[job.sensor])


def _photograph(oracle: Oracle, job: Measurement, camera: RigCamera) -> tuple[int, ...]:
    world = oracle.world
    frame = oracle.render(
        camera.camera,
        world.ego.at(job.timestamp_us) @ camera.rig_from_camera,
        timestamp_us=job.timestamp_us,
        exposure=exposure(world.seed, job.sensor),
        rng=_generator(oracle, _CAMERA_STREAM, job),
    )
    PillowImage.fromarray(frame.rgb).save(image_file(job.spool, job.sensor, job.frame))
    if job.truth is not None:
        write_truth_frame(job.truth, job.sensor, job.frame, frame.depth, frame.instance)
    return tuple(np.unique(frame.instance).tolist())


def _scan(oracle: Oracle, job: Measurement) -> tuple[int, ...]:
    world_from_lidar = oracle.world.ego.at(job.timestamp_us) @ job.rig.rig_from_lidar
    poses = oracle.logged_poses(job.timestamp_us)
    rng = _generator(oracle, _LIDAR_STREAM, job)
    drawn = oracle.drawn(poses)
    scan = scan_lidar(oracle.scene_at(drawn), WAYMO_TOP, world_from_lidar, drawn, rng)
    points = se3.apply(job.rig.rig_from_lidar, scan.points).astype(np.float32)
    path = _sweep_file(job.spool, job.frame)
    np.savez(path, points=points, intensity=scan.intensity.astype(np.float32))
    return tuple(np.unique(scan.instance).tolist())


def _generator(oracle: Oracle, stream: int, job: Measurement) -> np.random.Generator:
    return np.random.default_rng([oracle.world.seed, stream, sensor_number(job.sensor), job.frame])


def image_file(spool: Path, camera: str, frame: int) -> Path:
    """Where an image lies."""
    return spool / camera / f"{frame:04d}.png"


def _sweep_file(spool: Path, frame: int) -> Path:
    return spool / LIDAR / f"{frame:04d}.npz"


@dataclass(frozen=True)
class SpooledImages:
    """The images of one camera; see `recast.logs.types.EncodedImageSource`."""

    spool: Path
    camera: str
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Image:
        with PillowImage.open(image_file(self.spool, self.camera, index)) as image:
            return np.asarray(image)

    def encoded(self, index: int) -> tuple[bytes, str]:
        """The bytes of the PNG file."""
        return image_file(self.spool, self.camera, index).read_bytes(), "png"


@dataclass(frozen=True)
class SpooledSweeps:
    """All sweeps; see `recast.logs.types.SweepSource`."""

    spool: Path
    timestamps_us: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.timestamps_us)

    def __getitem__(self, index: int) -> LidarSweep:
        with np.load(_sweep_file(self.spool, index), allow_pickle=False) as archive:
            points, intensity = archive["points"], archive["intensity"]
        return LidarSweep(int(self.timestamps_us[index]), points, intensity)
