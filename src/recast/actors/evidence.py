"""What is known of one vehicle: single images, all of them with the LiDAR, and that on disk."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from recast.actors.actor import triple
from recast.actors.carve import FreeSpace
from recast.arrays import Array, Float32Array
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.records import Record, parse_record
from recast.logs.checks import WORLD_REACH, check_poses
from recast.scene import StreetScene
from recast.scene.poses import pose_at
from recast.scene.store import read_tensors, write_tensors

EVIDENCE_VERSION = 1
_MEND = "make the actor again"
_POSES = ("camera_from_world", "world_from_object")


@dataclass(frozen=True)
class Sighting:
    """One image of a log that shows the vehicle, cut to the vehicle and its surroundings.

    Attributes:
        camera_name, frame, timestamp_us: camera, frame number and log time of the image.
        camera: pinhole of the crop, without distortion.
        camera_from_world: (4, 4), with the correction that a scene has learned, if there is one.
        world_from_object: (4, 4); object frame: box centre, x forward, y left, z up.
        image: (H, W, 3) uint8 RGB.
        mask: (H, W) float32 in [0, 1], 1 on the vehicle.
        trust: (H, W) float32 in [0, 1]: how far `mask` is believed; 0 where something hides the
            vehicle or the image is not usable.
        weight: weight in [0, 1] of the image beside the others: size, sharpness, occlusion.
    """

    camera_name: str
    frame: int
    timestamp_us: int
    camera: PinholeCamera
    camera_from_world: Array
    world_from_object: Array
    image: NDArray[np.uint8]
    mask: Float32Array
    trust: Float32Array
    weight: float

    @property
    def camera_from_object(self) -> Array:
        """(4, 4)."""
        return self.camera_from_world @ self.world_from_object

    @property
    def eye(self) -> Array:
        """(3,) position of the camera in the object frame, metres."""
        pose = self.camera_from_object
        return -pose[:3, :3].T @ pose[:3, 3]


@dataclass(frozen=True)
class Evidence:
    """All that a log knows of a vehicle; held-out images are not in it.

    Attributes:
        track_id, category: id and category of the track.
        size: (3,) length, width, height of the logged box, metres.
        sightings: sightings in order of time.
        hits: (N, 3) float32 LiDAR points on the vehicle, object frame.
        free: cells of the box that LiDAR rays passed through.
        left_out: why images that show the box are not among the sightings, one entry an image.
    """

    track_id: str
    category: str
    size: Array
    sightings: tuple[Sighting, ...]
    hits: Float32Array
    free: FreeSpace
    left_out: tuple[str, ...] = ()

    def posed_by(self, scene: StreetScene) -> Evidence:
        """The evidence with the poses of cameras and track that a scene has learned.

        The scene must have a model of the track.
        """
        trajectory = scene.actors[self.track_id].trajectory
        sightings = []
        for sighting in self.sightings:
            time = sighting.timestamp_us
            pose = pose_at(trajectory, time)
            camera = scene.corrected_camera(sighting.camera_from_world, sighting.camera_name, time)
            if pose is not None:
                sightings.append(
                    replace(sighting, camera_from_world=camera, world_from_object=pose)
                )
        return replace(self, sightings=tuple(sightings))

    def explain(self) -> str:
        """A few lines for people."""
        cameras = Counter(sighting.camera_name for sighting in self.sightings)
        lines = [
            f"track {self.track_id}: {len(self.sightings)} images"
            + "".join(f", {count} of {name}" for name, count in cameras.items()),
            f"{len(self.hits)} LiDAR points, {len(self.free.centres)} cells of the box observed "
            "as empty",
        ]
        lines += [f"left out {count}: {reason}" for reason, count in Counter(self.left_out).items()]
        return "\n".join(lines)


class SightingRecord(Record):
    """What a sighting has beside its pixels and poses."""

    camera_name: str
    frame: int
    timestamp_us: int
    width: int
    height: int
    intrinsics: tuple[float, float, float, float]
    weight: float = Field(ge=0, le=1)


class EvidenceRecord(Record):
    """The header of an evidence file."""

    version: int
    track_id: str
    category: str
    size: tuple[float, float, float]
    edge: float = Field(gt=0)
    left_out: tuple[str, ...]
    sightings: tuple[SightingRecord, ...]


def save_evidence(evidence: Evidence, path: Path) -> None:
    """Write evidence to a file, whole or not at all; masks and trust are kept in 255ths.

    Raises:
        InputError: the disk refuses.
    """
    record = EvidenceRecord(
        version=EVIDENCE_VERSION,
        track_id=evidence.track_id,
        category=evidence.category,
        size=triple(evidence.size),
        edge=evidence.free.edge,
        left_out=evidence.left_out,
        sightings=tuple(
            SightingRecord(
                camera_name=one.camera_name,
                frame=one.frame,
                timestamp_us=one.timestamp_us,
                width=one.camera.width,
                height=one.camera.height,
                intrinsics=(one.camera.fx, one.camera.fy, one.camera.cx, one.camera.cy),
                weight=one.weight,
            )
            for one in evidence.sightings
        ),
    )
    tensors: dict[str, NDArray[Any]] = {"hits": evidence.hits, "free": evidence.free.centres}
    for number, sighting in enumerate(evidence.sightings):
        tensors[f"{number}.image"] = sighting.image
        for name in ("mask", "trust"):
            tensors[f"{number}.{name}"] = np.rint(getattr(sighting, name) * 255).astype(np.uint8)
        for name in _POSES:
            tensors[f"{number}.{name}"] = getattr(sighting, name)
    write_tensors(
        path,
        {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in tensors.items()},
        record.model_dump(mode="json"),
    )


def load_evidence(path: Path) -> Evidence:
    """Read an evidence file.

    Raises:
        InputError: missing, broken, of another version, or with values that no evidence has.
    """
    tensors, header = read_tensors(path)
    record = parse_record(path, header, EvidenceRecord, EVIDENCE_VERSION, _MEND)
    arrays = {name: value.numpy() for name, value in tensors.items()}
    return Evidence(
        track_id=record.track_id,
        category=record.category,
        size=np.array(record.size),
        sightings=tuple(
            _sighting(path, arrays, number, one) for number, one in enumerate(record.sightings)
        ),
        hits=_points(path, arrays, "hits"),
        free=FreeSpace(_points(path, arrays, "free"), record.edge),
        left_out=record.left_out,
    )


def _sighting(
    path: Path, arrays: dict[str, NDArray[Any]], number: int, record: SightingRecord
) -> Sighting:
    camera = PinholeCamera(record.width, record.height, *record.intrinsics)
    size = (record.height, record.width)

    def array(name: str, shape: tuple[int, ...], kind: type) -> NDArray[Any]:
        return _array(path, arrays, f"{number}.{name}", shape, kind)

    poses = {name: array(name, (4, 4), np.float64) for name in _POSES}
    try:
        camera.validate()
        for name, pose in poses.items():
            check_poses(name, pose[None], WORLD_REACH)
    except ValueError as error:
        raise InputError(path, f"sighting {number}", str(error), _MEND) from None
    return Sighting(
        camera_name=record.camera_name,
        frame=record.frame,
        timestamp_us=record.timestamp_us,
        camera=camera,
        image=array("image", (*size, 3), np.uint8),
        mask=array("mask", size, np.uint8).astype(np.float32) / np.float32(255),
        trust=array("trust", size, np.uint8).astype(np.float32) / np.float32(255),
        weight=record.weight,
        **poses,
    )


def _points(path: Path, arrays: dict[str, NDArray[Any]], name: str) -> NDArray[np.float32]:
    points = _array(path, arrays, name, (-1, 3), np.float32)
    if not np.all(np.isfinite(points)):
        raise InputError(path, name, "is not finite", _MEND)
    return points


def _array(
    path: Path, arrays: dict[str, NDArray[Any]], name: str, shape: tuple[int, ...], kind: type
) -> NDArray[Any]:
    """The array of a name; -1 in a shape stands for any number."""
    if name not in arrays:
        raise InputError(path, name, "is missing", _MEND)
    found = arrays[name]
    same = len(found.shape) == len(shape) and all(
        wanted in (-1, side) for wanted, side in zip(shape, found.shape, strict=True)
    )
    if not same or found.dtype != kind:
        problem = f"is {found.dtype} {found.shape}, expected {np.dtype(kind)} {shape}"
        raise InputError(path, name, problem, _MEND)
    return found
