"""Where a browser's camera can be sent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.geometry import se3
from recast.viewer.inputs import Drive

Array = NDArray[np.float64]

BEHIND_EGO = "behind the ego"
ABOVE = "from above"
AT_ACTOR = "beside the actor"

_FOV = np.radians(60.0)
_OVERVIEW = 30  # steps


@dataclass(frozen=True)
class Look:
    """A level camera.

    Attributes:
        eye, target: (3,) in the world, metres.
        fov: vertical, radians.
    """

    eye: Array
    target: Array
    fov: float = float(_FOV)


def look_names(drive: Drive) -> tuple[str, ...]:
    """Names of the places that a drive has."""
    names = []
    if drive.rig is not None:
        names += [BEHIND_EGO]
    if drive.controlled:
        names += [AT_ACTOR]
    return (*names, ABOVE, *drive.cameras)


def look(drive: Drive, name: str, step: int) -> Look:
    """A camera by name at a step.

    Raises:
        KeyError: the drive has no such place.
    """
    if name == BEHIND_EGO and drive.rig is not None:
        return _from(drive.rig[step], (-9.0, 0.0, 4.0), (10.0, 0.0, 0.5))
    if name == AT_ACTOR and drive.controlled:
        return beside(drive, drive.controlled[0], step)
    if name == ABOVE:
        middle = _middle(drive, step)
        return Look(middle + np.array([-12.0, 0.0, 32.0]), middle + np.array([4.0, 0.0, 0.0]))
    mount = drive.cameras[name]
    assert drive.rig is not None  # cameras are on a rig
    pose = drive.rig[step] @ mount.rig_from_camera
    return Look(pose[:3, 3], pose[:3, 3] + 10 * pose[:3, 2], mount.fov)


def beside(drive: Drive, track: str, step: int) -> Look:
    """A look at a track from ahead of it and to its left; from where it first is, before that."""
    poses = drive.poses[track]
    there = np.flatnonzero(~np.isnan(poses[:, 0, 0]))
    pose = poses[there[np.abs(there - step).argmin()]]
    reach = float(drive.sizes[track][0])
    return _from(pose, (1.1 * reach, 1.1 * reach, 0.45 * reach), (0.0, 0.0, 0.0))


def first_look(drive: Drive) -> Look:
    """What is seen when the page opens."""
    name = next(iter(look_names(drive)))
    return look(drive, name, 0)


def overview(drive: Drive) -> Look:
    """A look over all of a drive's first seconds from behind, for who cannot ride along."""
    if drive.rig is None:
        return first_look(drive)
    middle = drive.rig[min(len(drive) // 2, _OVERVIEW)]
    return _from(middle, (-20.0, 0.0, 8.0), (14.0, 0.0, 0.0))


def _middle(drive: Drive, step: int) -> Array:
    if drive.rig is not None:
        return np.asarray(drive.rig[step][:3, 3], np.float64)
    poses = drive.at(step) or {key: p[~np.isnan(p[:, 0, 0])][0] for key, p in drive.poses.items()}
    places = [pose[:3, 3] for pose in poses.values()]
    return np.mean(places, axis=0) if places else np.zeros(3)


def _from(pose: Array, eye: tuple[float, ...], target: tuple[float, ...]) -> Look:
    found = se3.apply(pose, np.array([eye, target]))
    return Look(found[0], found[1])
