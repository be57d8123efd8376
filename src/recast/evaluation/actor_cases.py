"""What generated vehicles are judged on: a picture to make one from, and others to compare with."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import PinholeCamera, se3
from recast.recar import RealView, holds_real_crops, read_real_crops
from recast.recar.record import SET_FILE
from recast.recar.shards.layout import INDEX_FILE
from recast.recar.shards.opening import open_set
from recast.recar.source import IdentitySource, VehicleSource

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

TARGET_AZIMUTHS = (0.0, 90.0, 180.0, 270.0)
"""Degrees of the views that a vehicle of a set is judged by (the paper, section 5, Q3)."""


@dataclass(frozen=True)
class ActorView:
    """A background-free picture of a vehicle and its camera; can be sent to other processes.

    Attributes:
        name: of the picture within the vehicle.
        load: gives (H, W, 4) uint8, straight alpha; raises InputError.
        camera: without distortion.
        camera_from_actor: (4, 4), actor frame: box centre, x forward, y left, z up.
    """

    name: str
    load: Callable[[], Image]
    camera: PinholeCamera
    camera_from_actor: Array

    @property
    def azimuth_deg(self) -> float:
        """Direction to the camera in [0, 360): 0 ahead of the vehicle, 90 to its left."""
        eye = -self.camera_from_actor[:3, :3].T @ self.camera_from_actor[:3, 3]
        return float(np.degrees(np.arctan2(eye[1], eye[0])) % 360.0)


@dataclass(frozen=True)
class ActorCase:
    """One vehicle to make and judge.

    Attributes:
        id: of the vehicle.
        category: of its label, see `recast.logs.Track`.
        size: (3,) length, width, height of its box, metres.
        inputs: views it may be made and placed by; a generator of one picture gets the first.
        targets: reserved views.
    """

    id: str
    category: str
    size: Array
    inputs: tuple[ActorView, ...]
    targets: tuple[ActorView, ...]


def read_cases(
    folder: str | Path, seed: int = 0, limit: int | None = None, views: int = 1
) -> list[ActorCase]:
    """The vehicles of a folder of real crops, or the held-out ones of a vehicle set.

    Of a set, one view is the input, drawn by `seed` and identity among those that are no target;
    further inputs are each as far as possible from those before. Targets are the views nearest to
    azimuth 0, 90, 180 and 270 degrees, the input left out.

    Args:
        folder: see `recast.recar.read_real_crops`; the set in folders or in shards.
        seed: of the choice of input views.
        limit: take only the first vehicles, sorted by id.
        views: number of inputs of a set's vehicle, at most.

    Raises:
        InputError: the folder is neither, or holds nothing to judge; `limit` or `views` below 1;
            what the readers refuse.
    """
    folder = Path(folder)
    for option, value in (("--limit", limit), ("--views", views)):
        if value is not None and value < 1:
            raise InputError(option, "value", f"is {value}", "give 1 or more")
    if not folder.is_dir():
        raise InputError(folder, "set", "is no folder", "check the path")
    if any((folder / name).exists() for name in (SET_FILE, INDEX_FILE)):
        vehicles: VehicleSource = open_set(folder)
        held_out = list(vehicles.of_split("held-out"))[:limit]
        cases = [_case_of_identity(folder, identity, seed, views) for identity in held_out]
        if not cases:
            raise InputError(folder, "held-out", "has no identity", "take a larger set")
        return cases
    if not holds_real_crops(folder):
        raise InputError(
            folder, "set", f"has no {SET_FILE}, no {INDEX_FILE} and no ID/input_views",
            "see docs/data.md, sections Vehicle sets and Real crops",
        )  # fmt: skip
    return [
        ActorCase(
            one.id,
            "car",
            one.size,
            tuple(_view_of_crop(view) for view in one.inputs),
            tuple(_view_of_crop(view) for view in one.reserved),
        )
        for one in read_real_crops(folder)[:limit]
    ]


def _view_of_crop(view: RealView) -> ActorView:
    return ActorView(view.image.stem, view.rgba, view.camera, se3.inverse(view.actor_from_camera))


def _case_of_identity(folder: Path, identity: IdentitySource, seed: int, views: int) -> ActorCase:
    record, shared = identity.record, identity.set_record
    where = folder / record.id
    if record.size is None:
        raise InputError(where, "size", "is null", "measure the vehicles: they are placed by it")
    targets = list(dict.fromkeys(_nearest(shared.azimuths_deg, goal) for goal in TARGET_AZIMUTHS))
    others = [index for index in range(shared.views) if index not in targets]
    # by name, not by place in the list: a set that grows keeps the inputs of all it had
    rng = np.random.default_rng([seed, zlib.crc32(record.id.encode())])
    chosen = int(rng.choice(others or targets))
    reserved = [index for index in targets if index != chosen]
    if not reserved:
        raise InputError(where, "views", "is one", "a set needs several views")
    return ActorCase(
        id=record.id,
        category=record.category,
        size=np.array(record.size),
        inputs=tuple(
            _view_of_set(where, identity, index)
            for index in _spread(shared.azimuths_deg, chosen, others, views)
        ),
        targets=tuple(_view_of_set(where, identity, index) for index in reserved),
    )


def _spread(azimuths: tuple[float, ...], first: int, among: list[int], count: int) -> list[int]:
    """`first`, then each the one farthest in azimuth from those before; of several, the first."""
    taken = [first]
    left = [index for index in among if index != first]
    while left and len(taken) < count:
        apart = [min(_apart(azimuths[index], azimuths[one]) for one in taken) for index in left]
        taken.append(left.pop(int(np.argmax(np.round(apart, 6)))))
    return taken


def _apart(first: float, second: float) -> float:
    """Degrees between two azimuths, in [0, 180]."""
    return abs((first - second + 180.0) % 360.0 - 180.0)


def _nearest(azimuths: tuple[float, ...], goal: float) -> int:
    """Index of the view nearest to an azimuth; of two, the first."""
    return int(np.argmin(np.round([_apart(one, goal) for one in azimuths], 6)))


def _view_of_set(where: Path, identity: IdentitySource, index: int) -> ActorView:
    try:
        camera, actor_from_camera = identity.camera(index)
    except ValueError as error:
        raise InputError(
            where, "camera", str(error), "only sets with measured cameras can be judged on"
        ) from None
    return ActorView(
        f"view_{index:02d}", partial(identity.view, index), camera, se3.inverse(actor_from_camera)
    )
