"""Where an imported scene lies in the log's world, and which times its frames have."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.logs.checks import WORLD_REACH
from recast.splats import Gaussians
from recast.storage import read_text

Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

TEXT_LIMIT = 1 << 16
"""Bytes of a file of a few numbers, at most."""


@dataclass(frozen=True)
class Placement:
    """Scene coordinates to the log's world.

    Attributes:
        world_from_scene: (4, 4) rigid.
        how: where it comes from, one sentence for people.
        scale: applied to scene coordinates first.
    """

    world_from_scene: Array
    how: str
    scale: float = 1.0


def read_numbers(path: Path, counts: Sequence[int]) -> Array:
    """All numbers of a text file, which commas and brackets may stand between.

    Raises:
        InputError: it is missing, holds something else, or has another number of numbers.
    """
    mend = f"write {' or '.join(map(str, counts))} numbers"
    words = re.sub(r"[\[\],;]", " ", read_text(path, TEXT_LIMIT)).split()
    try:
        numbers = np.array(words, np.float64)
    except ValueError as error:
        raise InputError(path, "numbers", f"cannot be read ({error})", mend) from None
    if len(numbers) not in counts or not np.all(np.abs(numbers) <= WORLD_REACH):  # also NaN
        problem = f"{len(numbers)}, or not all within {WORLD_REACH:g}"
        raise InputError(path, "numbers", problem, mend)
    return numbers


def read_transform(path: Path) -> Array:
    """A 4x4 matrix (16 numbers, row by row) or a translation (3 numbers): (4, 4).

    Raises:
        InputError: see `read_numbers`.
    """
    numbers = read_numbers(path, (3, 16))
    if len(numbers) == 3:
        return se3.from_rotation_translation(np.eye(3), numbers)
    return numbers.reshape(4, 4)


def given_placement(path: Path, scalable: bool = False) -> Placement:
    """The placement that a file tells.

    Args:
        scalable: whether the matrix may scale, by one factor for all axes.

    Raises:
        InputError: see `read_transform`; or the matrix shears, mirrors or scales.
    """
    matrix = read_transform(path)
    block = matrix[:3, :3]
    determinant = float(np.linalg.det(block))
    scale = abs(determinant) ** (1 / 3)
    unit = block / scale if determinant > 0 else np.zeros((3, 3))
    rotates = np.allclose(unit @ unit.T, np.eye(3), 0, 1e-4)
    if not rotates or not np.allclose(matrix[3], (0, 0, 0, 1)):
        kind = "a rotation, translation and scale" if scalable else "a rotation and translation"
        raise InputError(path, "matrix", f"is not {kind}", "write another one")
    if not scalable and abs(scale - 1) > 1e-4:
        raise InputError(path, "matrix", f"scales by {scale:.6g}", "write one in metres")
    left, _, right = np.linalg.svd(block)
    rigid = se3.from_rotation_translation(left @ right, matrix[:3, 3])
    return Placement(rigid, f"as given in {path.name}", scale if scalable else 1.0)


def frame_times(log: DrivingLog, clock: str | None, first: int = 0) -> Int64Array:
    """Times of the log's frames from `first` on: those of one of its sensors.

    Args:
        clock: a camera or LiDAR; where none is named, the LiDAR with most sweeps, else the camera
            with most images.

    Raises:
        InputError: the log has no such sensor, or no frame `first`.
    """
    lidars = {name: lidar.timestamps_us for name, lidar in log.lidars.items()}
    cameras = {name: camera.timestamps_us for name, camera in log.cameras.items()}
    sensors = {**lidars, **cameras}
    if clock is None:
        clock = max(lidars or cameras, key=lambda name: len(sensors[name]), default="")
    if clock not in sensors:
        raise InputError(
            log.name, f"clock {clock!r}", "is no sensor of the log",
            f"name one of {', '.join(sorted(sensors)) or 'none, there are no sensors'}",
        )  # fmt: skip
    times = sensors[clock]
    if not 0 <= first < len(times):
        raise InputError(
            log.name, f"frame {first}", f"{clock} has frames 0 to {len(times) - 1}", "name another"
        )
    return times[first:]


def drive_inside(log: DrivingLog, background: Gaussians) -> float:
    """Share of the recorded ego positions within the bounds of the background, seen from above.

    Bounds are the 1st and 99th percentile of the centres. Far less than 1 means that scene and log
    do not lie in the same frame.
    """
    low, high = np.quantile(background.means[:, :2].numpy(), (0.01, 0.99), axis=0)
    positions = log.world_from_rig.poses[:, :2, 3]
    return float(np.all((positions >= low) & (positions <= high), axis=1).mean())
