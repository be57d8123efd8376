"""The folder of one vehicle: which photograph is which view; walk-arounds and their camera poses.

    PHOTOS/ID/001.jpg, 002.jpg, ...         in order of azimuth; or a walk-around:
    PHOTOS/ID/images/*                      photographs at irregular azimuths; or PHOTOS/ID/*
    PHOTOS/ID/masks/*                       optional, by the photographs' names; 255 on the vehicle
    PHOTOS/ID/transforms.json, images.txt or sparse/0/images.txt    poses of NeRF or COLMAP

So come 3DRealCar and MAD-CARS into a vehicle set. What is known of them is what the RECAST paper
says (section 2): number of vehicles, photographs a vehicle, size, neither regular nor cut out. How
their archives are laid out is not: bring them into the layout above.

Frames: a pose is `world_from_camera` (4, 4), camera x right, y down, z forward (OpenCV); the world
is any right-handed frame of any unit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import disk_errors, member, read_json, read_text
from recast.core.records import validation_error
from recast.geometry import se3
from recast.recar.ingest_photograph import (
    SUFFIXES,
    PhotographCandidate,
    natural_order,
    photograph_size,
)
from recast.recar.ingest_table import IngestSettings, VehicleRow, WalkaroundLayout

AZIMUTH_WITHIN = 0.1
"""Share of the step between two views by which a measured azimuth may be off."""
Poses = dict[str, NDArray[np.float64]]

MOST_BYTES = 1 << 28
"""Most bytes of a file of poses; COLMAP's lists the features of every photograph too."""
_MEND = "write the poses again; see docs/recar.md#walk-arounds"
_RIGID_WITHIN = 1e-3
_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])

_MatrixRow = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


def photographs_of(photos: Path, row: VehicleRow, settings: IngestSettings) -> tuple[Path, ...]:
    """The photographs of a vehicle by rising azimuth, its front first; headers are read.

    Raises:
        InputError: the folder is missing, photographs are missing, too many or of several sizes,
            or their azimuths are not regular.
    """
    folder, found, others = _listed(photos, row)
    if len(found) != settings.views:
        looked = f" ({others} other files were ignored)" if others else ""
        problem = f"are {len(found)}, but the set has {settings.views} views{looked}"
        mend = "add the missing azimuths, or give `views`"
        raise InputError(folder, "photographs", problem, mend)
    ordered = (
        _by_azimuth(folder, found, row) if row.azimuths_deg else _by_order(found, row, settings)
    )
    check_sizes(ordered, settings)
    return tuple(ordered)


def _listed(photos: Path, row: VehicleRow, inner: str = "") -> tuple[Path, list[Path], int]:
    """Folder of a vehicle, its photographs in natural order, and the number of other files.

    Photographs are looked for in the folder `inner` of it, if there is one.
    """
    folder = member(photos, row.folder or row.id, row.id, "folder")
    with disk_errors(folder):
        if not folder.is_dir():
            mend = f"add the folder, or remove {row.id} from the table"
            raise InputError(folder, "folder", "is missing", mend)
        place = folder / inner if (folder / inner).is_dir() else folder
        files = [path for path in place.iterdir() if path.is_file() and path.name[0] != "."]
    found = sorted((f for f in files if f.suffix.lower() in SUFFIXES), key=natural_order)
    return folder, found, len(files) - len(found)


def _by_order(found: list[Path], row: VehicleRow, settings: IngestSettings) -> list[Path]:
    if row.front > len(found):
        problem = f"is {row.front}, but there are {len(found)} photographs"
        raise InputError(row.id, "front", problem, "count from 1")
    turned = found[row.front - 1 :] + found[: row.front - 1]
    return [turned[0], *reversed(turned[1:])] if settings.clockwise else turned


def _by_azimuth(folder: Path, found: list[Path], row: VehicleRow) -> list[Path]:
    azimuths: Sequence[float] = row.azimuths_deg or ()
    if len(azimuths) != len(found):
        problem = f"are {len(azimuths)} for {len(found)} photographs"
        raise InputError(folder, "azimuths_deg", problem, "give one azimuth for each photograph")
    step = 360 / len(found)
    places: dict[int, Path] = {}
    for path, azimuth in zip(found, azimuths, strict=True):
        place = round(azimuth / step) % len(found)
        off = (azimuth - place * step + 180) % 360 - 180
        if abs(off) > AZIMUTH_WITHIN * step or place in places:
            problem = f"{azimuth:g} is not regular: expected one at every {step:g} degrees from 0"
            raise InputError(path, "azimuth", problem, "take the photographs at regular azimuths")
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
            problem = f"is {size[0]}x{size[1]}, but {paths[0].name} has {width}x{height}"
            mend = "give all photographs of a vehicle the same size"
            raise InputError(path, "size", problem, mend)
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
    transform_matrix: tuple[_MatrixRow, _MatrixRow, _MatrixRow, _MatrixRow]


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


_FLAT = 0.5  # spread of the cameras across their ring, over that along it, at most


def pick_photographs(
    photos: Path, row: VehicleRow, views: int, within_deg: float, layout: WalkaroundLayout
) -> PhotographCandidate:
    """For each of `views` regular azimuths one photograph that is near.

    Of those within `within_deg` it is the one with the least sum of the distances, in degrees, to
    that azimuth and to the median elevation of all; none is taken twice. Poses come from the
    vehicle's folder, or azimuths from its row.

    Args:
        row: row that names the photograph that shows the front, by its number in natural order.
        within_deg: degrees by which a photograph may be off.

    Raises:
        InputError: photographs or poses are missing, the front is not named, the cameras do not go
            around the vehicle, or no photograph is near an azimuth.
    """
    folder, found, _ = _listed(photos, row, "images")
    if len(found) < views:
        problem = f"are {len(found)}, but the set has {views} views"
        raise InputError(folder, "photographs", problem, "give fewer `views`")
    known, azimuths, elevations = _directions(folder, found, row)
    taken, off = _nearest(folder, azimuths, elevations, views, within_deg)
    photographs = tuple(known[index] for index in taken)
    return PhotographCandidate(
        row,
        photographs,
        tuple(_mask(folder, path) for path in photographs),
        _doubts(photographs, len(found) - len(known), off, elevations[taken], layout),
    )


def around(poses: Array, front: int) -> tuple[Array, Array]:
    """Azimuths (N,) in [0, 360) and elevations (N,) in degrees of cameras that ring a vehicle.

    The vehicle is where the optical axes meet best (least squares); up is the normal of the plane
    through the cameras, on the side to which the images' upper edges point on average. Azimuth 0 is
    that of the camera `front`; 90 is to the vehicle's left.

    Args:
        poses: (N, 4, 4) `world_from_camera`, OpenCV.
        front: index of the camera at azimuth 0.

    Raises:
        ValueError: the cameras lie on a line, or in no plane, or above the vehicle; or their axes
            are parallel.
    """
    places, forward = poses[:, :3, 3], poses[:, :3, 2]
    spread = places - places.mean(axis=0)
    _, sizes, axes = np.linalg.svd(spread, full_matrices=True)
    if len(places) < 3 or sizes[1] < 1e-6 * max(sizes[0], 1e-12) or sizes[2] > _FLAT * sizes[1]:
        raise ValueError("are not in a ring")
    up = axes[2] * np.sign(-poses[:, :3, 1].mean(axis=0) @ axes[2] or 1.0)
    across = np.eye(3) - forward[:, :, None] * forward[:, None, :]  # away from each optical axis
    if np.linalg.cond(across.sum(axis=0)) > 1e6:
        raise ValueError("look the same way")
    centre = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, places))
    seen = places - centre
    height = seen @ up
    flat = seen - height[:, None] * up
    reach = np.linalg.norm(flat, axis=1)
    if reach.min() < 1e-6 * reach.max():
        raise ValueError("are right above the vehicle")
    ahead = flat[front] / reach[front]
    azimuths = np.degrees(np.arctan2(flat @ np.cross(up, ahead), flat @ ahead)) % 360.0
    return azimuths, np.degrees(np.arctan2(height, reach))


def _directions(
    folder: Path, found: list[Path], row: VehicleRow
) -> tuple[list[Path], Array, Array]:
    """Photographs whose direction is known, their azimuths and elevations in degrees."""
    if row.azimuths_deg is not None:
        if len(row.azimuths_deg) != len(found):
            problem = f"are {len(row.azimuths_deg)} for {len(found)} photographs"
            mend = "give one azimuth for each photograph"
            raise InputError(folder, "azimuths_deg", problem, mend)
        return found, np.array(row.azimuths_deg) % 360.0, np.zeros(len(found))
    poses = read_poses(folder)
    if poses is None:
        mend = "add transforms.json or COLMAP's images.txt, or give azimuths_deg in the table"
        raise InputError(folder, "poses", "are missing", mend)
    if "front" not in row.model_fields_set:
        problem = "is missing: poses do not say where the front of the vehicle is"
        mend = "give the number of the photograph that shows its front, from 1"
        raise InputError(row.id, "front", problem, mend)
    known = [path for path in found if path.name in poses]
    if row.front > len(found) or found[row.front - 1] not in known:
        problem = f"is {row.front}, but that photograph has no pose (of {len(found)} photographs)"
        raise InputError(row.id, "front", problem, "give the number of another photograph")
    stacked = np.stack([poses[path.name] for path in known])
    try:
        return known, *around(stacked, known.index(found[row.front - 1]))
    except ValueError as error:
        raise InputError(folder, "poses", str(error), "give azimuths_deg in the table") from None


def _nearest(
    folder: Path, azimuths: Array, elevations: Array, views: int, within_deg: float
) -> tuple[list[int], float]:
    """Indices of the photographs taken, and by how many degrees of azimuth one is off at most."""
    unlike = np.abs(elevations - np.median(elevations))
    taken: list[int] = []
    worst = 0.0
    for goal in 360.0 / views * np.arange(views):
        off = np.abs((azimuths - goal + 180.0) % 360.0 - 180.0)
        fits = off <= within_deg
        fits[taken] = False
        if not fits.any():
            problem = f"no photograph is within {within_deg:g} degrees of {goal:g}"
            mend = "give fewer `views`, or a larger `azimuth_within`"
            raise InputError(folder, "azimuths", problem, mend)
        taken.append(int(np.argmin(np.where(fits, off + unlike, np.inf))))
        worst = max(worst, float(off[taken[-1]]))
    return taken, worst


def _mask(folder: Path, photograph: Path) -> Path | None:
    """A mask of the name of a photograph, its ending its own or that of a PNG."""
    names = (f"{photograph.stem}.png", photograph.name, f"{photograph.name}.png")
    return next((path for name in names if (path := folder / "masks" / name).is_file()), None)


def _doubts(
    photographs: tuple[Path, ...],
    unknown: int,
    off: float,
    elevations: Array,
    layout: WalkaroundLayout,
) -> tuple[str, ...]:
    doubts = []
    step = 360.0 / len(photographs)
    if off > AZIMUTH_WITHIN * step:
        doubts.append(
            f"azimuths are off by up to {off:.1f} degrees (views are {step:g} degrees apart)"
        )
    if np.ptp(elevations) > 1.0:
        doubts.append(f"elevations are {elevations.min():.1f} to {elevations.max():.1f} degrees")
    if unknown:
        doubts.append(f"{unknown} photographs have no pose")
    sizes = {photograph_size(path) for path in photographs}
    if others := sizes - {(layout.width, layout.height), (layout.height, layout.width)}:
        width, height = min(others)
        doubts.append(
            f"a photograph is {width}x{height}; {layout.title} has {layout.width}x{layout.height}"
        )
    return tuple(doubts)
