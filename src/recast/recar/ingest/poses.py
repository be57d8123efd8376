"""Camera poses beside the photographs of one vehicle: NeRF's transforms.json, COLMAP's text.

Frames: a pose is `world_from_camera` (4, 4), camera x right, y down, z forward (OpenCV); the world
is any right-handed frame of any unit.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from recast.errors import InputError
from recast.geometry import se3
from recast.records import validation_error
from recast.storage import read_json, read_text

Poses = dict[str, NDArray[np.float64]]

MOST_BYTES = 1 << 28
"""Most bytes of a file of poses; COLMAP's lists the features of every photograph too."""
_MEND = "write the poses anew; docs/recar.md, section Walk-arounds"
_RIGID_WITHIN = 1e-3
_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])

_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class _Frame(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    file_path: str = Field(min_length=1)
    transform_matrix: tuple[_Row, _Row, _Row, _Row]


class _Transforms(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    frames: tuple[_Frame, ...] = Field(min_length=1)


def read_poses(folder: Path) -> Poses | None:
    """Poses by file name of the photograph, without folders; None where there is no file of them.

    Looked for are `transforms.json`, `images.txt` and `sparse/0/images.txt`.

    Raises:
        InputError: several of them, one that cannot be read, or two poses of one photograph.
    """
    found = [name for name in _READERS if (folder / name).is_file()]
    if not found:
        return None
    if len(found) > 1:
        raise InputError(folder, "poses", f"are in {' and in '.join(found)}", "keep one of them")
    path = folder / found[0]
    poses: Poses = {}
    for name, pose in _READERS[found[0]](path):
        name = PurePosixPath(name.replace("\\", "/")).name
        if name in poses:
            raise InputError(path, name, "has two poses", _MEND)
        poses[name] = _rigid(path, name, pose)
    if not poses:
        raise InputError(path, "poses", "are none", _MEND)
    return poses


def _read_transforms(path: Path) -> list[tuple[str, NDArray[np.float64]]]:
    """transforms.json of NeRF: `world_from_camera`, camera x right, y up, z back (OpenGL)."""
    value = read_json(path)
    try:
        frames = _Transforms.model_validate(value).frames
    except ValidationError as error:
        raise validation_error(path, error, _MEND) from None
    return [
        (frame.file_path, np.array(frame.transform_matrix) @ _OPENCV_FROM_OPENGL)
        for frame in frames
    ]


def _read_colmap(path: Path) -> list[tuple[str, NDArray[np.float64]]]:
    """images.txt of COLMAP: two lines a photograph, of which the second, its features, is skipped.

    The first is IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, of `camera_from_world`.
    """
    lines = [line for line in read_text(path, MOST_BYTES).splitlines() if not line.startswith("#")]
    poses = []
    for number, line in enumerate(lines[::2]):
        words = line.split(maxsplit=9)
        if not words and number == len(lines[::2]) - 1:
            break  # an empty line at the end
        try:
            if len(words) != 10:
                raise ValueError(f"has {len(words)} words, not 10")
            numbers = np.array([float(word) for word in words[1:8]])
            if not np.isfinite(numbers).all() or not numbers[:4].any():
                raise ValueError("has no finite pose")
        except ValueError as error:
            raise InputError(path, f"photograph {number + 1}", str(error), _MEND) from None
        rotation = se3.quat_to_matrix(numbers[:4] / np.linalg.norm(numbers[:4]))
        pose = se3.inverse(se3.from_rotation_translation(rotation, numbers[4:]))
        poses.append((words[9], pose))
    return poses


def _rigid(path: Path, name: str, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose, its rotation freed of a common scale that some tools leave in it."""
    scale = float(np.cbrt(max(np.linalg.det(pose[:3, :3]), 0.0)))
    rotation = pose[:3, :3] / scale if scale > 0 else np.zeros((3, 3))
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not off < _RIGID_WITHIN or not np.allclose(pose[3], [0, 0, 0, 1], atol=_RIGID_WITHIN):
        raise InputError(path, name, "has a pose that is no rotation and translation", _MEND)
    return se3.from_rotation_translation(rotation, pose[:3, 3])


_READERS: dict[str, Callable[[Path], list[tuple[str, NDArray[np.float64]]]]] = {
    "transforms.json": _read_transforms,
    "images.txt": _read_colmap,
    "sparse/0/images.txt": _read_colmap,
}
