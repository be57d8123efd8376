"""What the processed Waymo folders of Street Gaussians and DriveStudio have in common.

One folder for each scene, with images, ego poses and calibration in text files:
`images/FRAME_CAMERA.png|jpg`, `ego_pose/FRAME.txt`, `extrinsics/CAMERA.txt`,
`intrinsics/CAMERA.txt`. Frames and cameras are numbers.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.files import read_text
from recast.geometry import se3
from recast.logs import checks
from recast.logs.images import ImageFiles, image_size
from recast.logs.importers.common import check_drive, nearest_rotation, unknown_drive, words_of
from recast.logs.importers.waymo_proto import CAMERA_NAME
from recast.logs.plausibility import off_centre
from recast.logs.types import Array, CameraStream

CAMERAS = tuple(CAMERA_NAME.names.values())
"""Waymo's cameras by their number in file names, which is Waymo's CameraName less one."""
RECORDED = (*[(1920, 1280)] * 3, *[(1920, 886)] * 2)
"""Width and height of Waymo's images by the camera's number."""
FARTHEST = 500.0
"""Metres from the ego: no LiDAR sees farther, so such a box is of another place or frame."""

_MEND = "process the scene again"
NUMBER = re.compile(r"[0-9]{1,9}")
"""A frame, in names of files."""
_IMAGE = re.compile(r"([0-9]{1,9})_([0-9])\.(?:png|jpg|jpeg)", re.IGNORECASE)
_TEXT_LIMIT = 1 << 16
"""Bytes of a file of numbers, at most."""


def find_scene(root: Path, drive: str, kind: str) -> Path:
    """The folder of scene `drive`: in `root`, or `root` itself. Raises InputError: the folder or
    the scene does not exist."""
    if not root.is_dir():
        raise InputError(root, f"{kind} folder", "does not exist", "check the path")
    check_drive(root, drive)
    for folder in (root / drive, root):
        if folder.name == drive and folder.is_dir():
            return folder
    found = (path.parent.name for path in root.glob("*/ego_pose"))
    raise unknown_drive(root, drive, found, "check the path: no drive was found")


def read_numbers(path: Path, count: int) -> Array:
    """`count` finite numbers of a text file. Raises InputError: the file is missing, or holds
    anything else."""
    if not path.is_file():
        raise InputError(path, "file", "is missing", _MEND)
    words = words_of(read_text(path, _TEXT_LIMIT))
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        raise InputError(path, "numbers", "cannot be read: not plain numbers", _MEND) from None
    if numbers.shape != (count,) or not np.all(np.isfinite(numbers)):
        problem = f"{count} finite numbers are needed, got {len(numbers)}"
        raise InputError(path, "numbers", problem, _MEND)
    return numbers


def read_pose(path: Path) -> Array:
    """A rigid transform (4, 4) of a text file of 16 numbers, row by row. Raises InputError: see
    `read_numbers`; the matrix is not rigid."""
    return rigid(read_numbers(path, 16), path, "matrix")


def rigid(values: Array, path: Path, field: str) -> Array:
    """Sixteen numbers as a transform (4, 4), its rotation made exactly orthogonal. Raises
    InputError: they are no rotation and translation."""
    matrix = np.asarray(values, np.float64).reshape(4, 4)
    # The comparisons are false for NaN; nothing that is not finite gets to the decomposition.
    if not np.all(np.abs(matrix[:3, :3]) <= 2.0) or not np.all(
        np.abs(matrix[:3, 3]) <= checks.WORLD_REACH
    ):
        raise InputError(path, field, "is not a rotation and translation", _MEND)
    rotation = nearest_rotation(matrix[:3, :3])
    if rotation is None or matrix[3].tolist() != [0, 0, 0, 1]:
        raise InputError(path, field, "is not a rotation and translation", _MEND)
    return se3.from_rotation_translation(rotation, matrix[:3, 3])


def frame_numbers(folder: Path) -> dict[int, Path]:
    """Poses of whole frames in `ego_pose`, by frame, in order. Raises InputError: there are fewer
    than two."""
    paths = {int(path.stem): path for path in folder.glob("*.txt") if NUMBER.fullmatch(path.stem)}
    if len(paths) < 2:
        raise InputError(folder, "FRAME.txt", f"there are {len(paths)} files, 2 are needed", _MEND)
    return dict(sorted(paths.items()))


@dataclass(frozen=True)
class CameraFolder:
    """One camera of a processed scene."""

    number: int  # number of the camera in file names
    images: Mapping[int, Path]  # image files by frame, in order
    # intrinsics with the lens distortion of Waymo's images, which are as recorded.
    camera: PinholeCamera
    extrinsic: Array  # (4, 4) transform from the camera to the vehicle, as written in its file

    @property
    def name(self) -> str:
        """Waymo's name of the camera."""
        return CAMERAS[self.number]

    def stream(self, rig_from_camera: Array, times: Mapping[int, int]) -> CameraStream:
        """The images in the order of their `times` by frame, microseconds."""
        frames = sorted(self.images, key=lambda frame: times[frame])
        paths = tuple(self.images[frame] for frame in frames)
        return CameraStream(
            name=self.name,
            camera=self.camera,
            rig_from_camera=rig_from_camera,
            timestamps_us=np.array([times[frame] for frame in frames], np.int64),
            images=ImageFiles(paths, self.camera.width, self.camera.height, "its first image"),
        )


def read_cameras(scene: Path) -> list[CameraFolder]:
    """All cameras that have images, with their calibration. Raises InputError: an image's name or
    camera is unknown, a frame of a camera is there twice, or a camera has no calibration."""
    listed: dict[int, dict[int, Path]] = {}
    for path in sorted((scene / "images").glob("*")):
        parts = _IMAGE.fullmatch(path.name)
        if parts is None or int(parts[2]) >= len(CAMERAS):
            problem = "is not FRAME_CAMERA.png or .jpg with a camera from 0 to 4"
            raise InputError(path, "file name", problem, "remove the file")
        images = listed.setdefault(int(parts[2]), {})
        if (other := images.setdefault(int(parts[1]), path)) != path:
            problem = f"is the same frame as {other.name}"
            raise InputError(path, "file name", problem, "remove one of the two")
    return [_camera(scene, number, listed[number]) for number in sorted(listed)]


def _camera(scene: Path, number: int, images: dict[int, Path]) -> CameraFolder:
    path = scene / "intrinsics" / f"{number}.txt"
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = read_numbers(path, 9).tolist()
    width, height = image_size(next(iter(images.values())))
    # Waymo counts pixels from the edge of the image, as we do: nothing is added to cx and cy.
    camera = PinholeCamera(width, height, fx, fy, cx, cy, (k1, k2, p1, p2, k3))
    try:
        camera.validate()
    except ValueError as error:
        raise InputError(path, "numbers", str(error), _MEND) from None
    # Images are often made smaller on their way, and the intrinsics forgotten. Waymo's own sizes
    # tell by how much; others are left to `plausibility.examined`.
    long, high = RECORDED[number]
    recorded = replace(camera, width=long, height=high)
    if abs(width * high / long - height) <= 1 and off_centre(recorded) < off_centre(camera):
        camera = recorded.resized(width, height)
    extrinsic = read_pose(scene / "extrinsics" / f"{number}.txt")
    return CameraFolder(number, dict(sorted(images.items())), camera, extrinsic)
