"""The folder of one vehicle: which photograph is which view, and the camera poses beside them.

Poses are read from NeRF's transforms.json or COLMAP's text. Frames: a pose is `world_from_camera`
(4, 4), camera x right, y down, z forward (OpenCV); the world is any right-handed frame of any
unit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from recast.core.errors import InputError
from recast.core.files import disk_errors, read_json, read_text
from recast.core.names import member
from recast.core.records import validation_error
from recast.geometry import se3
from recast.recar.ingest.photograph import SUFFIXES, natural_order, photograph_size
from recast.recar.ingest.settings import IngestSettings, VehicleRow

AZIMUTH_WITHIN = 0.1
"""Share of the step between two views by which a measured azimuth may be off."""
Poses = dict[str, NDArray[np.float64]]

MOST_BYTES = 1 << 28
"""Most bytes of a file of poses; COLMAP's lists the features of every photograph too."""
_MEND = "write the poses again; see docs/recar.md#walk-arounds"
_RIGID_WITHIN = 1e-3
_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])

_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


def photographs_of(photos: Path, row: VehicleRow, settings: IngestSettings) -> tuple[Path, ...]:
    """The photographs of a vehicle by rising azimuth, its front first; headers are read.

    Raises:
        InputError: the folder is missing, photographs are missing, too many or of several sizes,
            or their azimuths are not regular.
    """
    folder = member(photos, row.folder or row.id, row.id, "folder")
    with disk_errors(folder):
        if not folder.is_dir():
            mend = f"add the folder, or remove {row.id} from the table"
            raise InputError(folder, "folder", "is missing", mend)
        files = [path for path in folder.iterdir() if path.is_file() and path.name[0] != "."]
    found = sorted((f for f in files if f.suffix.lower() in SUFFIXES), key=natural_order)
    if len(found) != settings.views:
        others = len(files) - len(found)
        looked = f" ({others} other files were ignored)" if others else ""
        raise InputError(
            folder,
            "photographs",
            f"are {len(found)}, but the set has {settings.views} views{looked}",
            "add the missing azimuths, or give `views`",
        )
    ordered = (
        _by_azimuth(folder, found, row) if row.azimuths_deg else _by_order(found, row, settings)
    )
    check_sizes(ordered, settings)
    return tuple(ordered)


def _by_order(found: list[Path], row: VehicleRow, settings: IngestSettings) -> list[Path]:
    if row.front > len(found):
        raise InputError(
            row.id,
            "front",
            f"is {row.front}, but there are {len(found)} photographs",
            "count from 1",
        )
    turned = found[row.front - 1 :] + found[: row.front - 1]
    return [turned[0], *reversed(turned[1:])] if settings.clockwise else turned


def _by_azimuth(folder: Path, found: list[Path], row: VehicleRow) -> list[Path]:
    azimuths: Sequence[float] = row.azimuths_deg or ()
    if len(azimuths) != len(found):
        raise InputError(
            folder,
            "azimuths_deg",
            f"are {len(azimuths)} for {len(found)} photographs",
            "give one azimuth for each photograph",
        )
    step = 360 / len(found)
    places: dict[int, Path] = {}
    for path, azimuth in zip(found, azimuths, strict=True):
        place = round(azimuth / step) % len(found)
        off = (azimuth - place * step + 180) % 360 - 180
        if abs(off) > AZIMUTH_WITHIN * step or place in places:
            raise InputError(
                path,
                "azimuth",
                f"{azimuth:g} is not regular: expected one at every {step:g} degrees from 0",
                "take the photographs at regular azimuths",
            )
        places[place] = path
    return [places[place] for place in range(len(found))]


def check_sizes(paths: Sequence[Path], settings: IngestSettings) -> None:
    """Look at the headers of the photographs of a vehicle.

    Raises:
        InputError: they have several sizes, or not the shape that an angle of view needs.
    """
    width, height = photograph_size(paths[0])
    for path in paths:
        size = photograph_size(path)
        if size != (width, height):
            raise InputError(
                path,
                "size",
                f"is {size[0]}x{size[1]}, but {paths[0].name} has {width}x{height}",
                "give all photographs of a vehicle the same size",
            )
    scale = min(settings.width / width, settings.height / height)
    if settings.fov_deg is not None and round(width * scale) != settings.width:
        raise InputError(
            paths[0],
            "size",
            f"is {width}x{height}, not of the aspect ratio of {settings.width}x{settings.height}",
            "with `fov`, give a `width` and `height` of the photographs' aspect ratio",
        )


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
        raise InputError(
            folder, "poses", f"are in {' and in '.join(found)}", "keep one of these files"
        )
    path = folder / found[0]
    poses: Poses = {}
    for name, pose in _READERS[found[0]](path):
        name = PurePosixPath(name.replace("\\", "/")).name
        if name in poses:
            raise InputError(path, name, "has two poses", _MEND)
        poses[name] = _rigid(path, name, pose)
    if not poses:
        raise InputError(path, "poses", "are missing", _MEND)
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
                raise ValueError(f"has {len(words)} words, expected 10")
            numbers = np.array([float(word) for word in words[1:8]])
            if not np.isfinite(numbers).all() or not numbers[:4].any():
                raise ValueError("has a pose that is not finite")
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
        raise InputError(path, name, "has a pose that is not a rotation and a translation", _MEND)
    return se3.from_rotation_translation(rotation, pose[:3, 3])


_READERS: dict[str, Callable[[Path], list[tuple[str, NDArray[np.float64]]]]] = {
    "transforms.json": _read_transforms,
    "images.txt": _read_colmap,
    "sparse/0/images.txt": _read_colmap,
}
