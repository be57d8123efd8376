"""Walk-arounds: many photographs of a vehicle at irregular azimuths, of which some are taken.

    PHOTOS/ID/images/*                      photographs; or PHOTOS/ID/*
    PHOTOS/ID/masks/*                       optional, by the photographs' names; 255 on the vehicle
    PHOTOS/ID/transforms.json, images.txt or sparse/0/images.txt    see `recast.recar.ingest.folder`

So come 3DRealCar and MAD-CARS into a vehicle set. What is known of them is what the RECAST paper
says (section 2): number of vehicles, photographs a vehicle, size, neither regular nor cut out. How
their archives are laid out is not: bring them into the layout above.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import disk_errors
from recast.core.names import member
from recast.recar.ingest.folder import AZIMUTH_WITHIN, read_poses
from recast.recar.ingest.photograph import (
    SUFFIXES,
    PhotographCandidate,
    natural_order,
    photograph_size,
)
from recast.recar.ingest.settings import VehicleRow, WalkaroundLayout

_FLAT = 0.5  # spread of the cameras across their ring, over that along it, at most


def pick_photographs(
    photos: Path, row: VehicleRow, views: int, within_deg: float, layout: WalkaroundLayout
) -> PhotographCandidate:
    """For each of `views` regular azimuths one photograph that is near.

    Of those within `within_deg` it is the one with the least sum of the distances, in degrees, to
    that azimuth and to the median elevation of all; none is taken twice. Poses come from the
    vehicle's folder, or azimuths from its row.

    Args:
        photos: folder that holds a folder for each vehicle.
        row: row that names the photograph that shows the front, by its number in natural order.
        views: number of views of the set.
        within_deg: degrees by which a photograph may be off.
        layout: layout whose published size is looked for.

    Raises:
        InputError: photographs or poses are missing, the front is not named, the cameras do not go
            around the vehicle, or no photograph is near an azimuth.
    """
    folder = member(photos, row.folder or row.id, row.id, "folder")
    found = _photographs(folder)
    if len(found) < views:
        raise InputError(
            folder,
            "photographs",
            f"are {len(found)}, but the set has {views} views",
            "give fewer `views`",
        )
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


def _photographs(folder: Path) -> list[Path]:
    with disk_errors(folder):
        if not folder.is_dir():
            raise InputError(
                folder, "folder", "is missing", "add the folder, or remove its row from the table"
            )
        inner = folder / "images"
        files = (inner if inner.is_dir() else folder).iterdir()
        found = [path for path in files if path.is_file() and path.name[0] != "."]
    return sorted((f for f in found if f.suffix.lower() in SUFFIXES), key=natural_order)


def _directions(
    folder: Path, found: list[Path], row: VehicleRow
) -> tuple[list[Path], Array, Array]:
    """Photographs whose direction is known, their azimuths and elevations in degrees."""
    if row.azimuths_deg is not None:
        if len(row.azimuths_deg) != len(found):
            raise InputError(
                folder,
                "azimuths_deg",
                f"are {len(row.azimuths_deg)} for {len(found)} photographs",
                "give one azimuth for each photograph",
            )
        return found, np.array(row.azimuths_deg) % 360.0, np.zeros(len(found))
    poses = read_poses(folder)
    if poses is None:
        raise InputError(
            folder,
            "poses",
            "are missing",
            "add transforms.json or COLMAP's images.txt, or give azimuths_deg in the table",
        )
    if "front" not in row.model_fields_set:
        raise InputError(
            row.id,
            "front",
            "is missing: poses do not say where the front of the vehicle is",
            "give the number of the photograph that shows its front, from 1",
        )
    known = [path for path in found if path.name in poses]
    if row.front > len(found) or found[row.front - 1] not in known:
        raise InputError(
            row.id,
            "front",
            f"is {row.front}, but that photograph has no pose (of {len(found)} photographs)",
            "give the number of another photograph",
        )
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
            raise InputError(
                folder,
                "azimuths",
                f"no photograph is within {within_deg:g} degrees of {goal:g}",
                "give fewer `views`, or a larger `azimuth_within`",
            )
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
