"""The space a vehicle fills: its visual hull in all masks, and cells that LiDAR rays crossed.

Single masks err: a shadow, a neighbour, a window that shows the road behind. They err differently
in every image, but the vehicle is one body. Its visual hull is carved from all masks at once, and
each mask is believed where it agrees with the hull's outline.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from recast.actors.actor import triple
from recast.actors.observation import crossing
from recast.arrays import Array, Float32Array
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.records import Record, parse_record
from recast.geometry import se3
from recast.logs import DrivingLog, Track
from recast.logs.checks import WORLD_REACH, check_poses
from recast.scene import StreetScene
from recast.scene.store import read_tensors, write_tensors
from recast.scene.street_scene import pose_at

EDGE = 0.08
"""Edge of a cell, metres."""
_RAYS = 2  # that passed: one may have met its target at the wrong time
_NEAR_HIT = 0.12  # metres around a hit that are not free: noise, and the pose of a moving vehicle
_BEHIND = 0.5  # metres beyond the box at which a ray must end: it may have ended on the far side
_GROWTH = 0.1  # metres by which the box is grown

_CELLS = 60  # along the length
_WIDER = 0.08  # share of the box by which the grid is larger
_SOLID = 0.75  # share of the weight of the images that see a cell which must have it in their mask
_DOUBT = 51 / 255  # trust in a pixel about which mask and hull differ
LEAST_AGREEMENT = 0.5
"""Overlap (IoU) of a mask and the hull's outline below which the image is left out."""


@dataclass(frozen=True)
class FreeSpace:
    """Cells that are seen to be empty."""

    centres: NDArray[np.float32]  # (M, 3) float32, object frame, metres
    edge: float = EDGE  # edge length of a cell, metres

    def holds(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Which points (N, 3) lie in a free cell."""
        points = np.asarray(points, np.float64)
        if len(self.centres) == 0:
            return np.zeros(len(points), bool)
        near, _ = cKDTree(self.centres).query(points, p=np.inf)
        return near <= self.edge / 2 + 1e-6


def free_space(log: DrivingLog, track: Track, hits: ArrayLike) -> FreeSpace:
    """Cells of a track's box through which at least two rays passed to what lies behind.

    A ray that ends in the box, or less than half a metre beyond it, says nothing: it may have gone
    through glass. So may one that passes two windows; cells near a hit are not free.

    Args:
        hits: (N, 3) LiDAR points on the vehicle, object frame.
    """
    hits = np.asarray(hits, np.float64)
    half = np.asarray(track.size, np.float64) / 2 + _GROWTH
    shape = np.ceil(2 * half / EDGE).astype(int)
    passed = np.zeros(int(np.prod(shape)), np.int64)
    for lidar in log.lidars.values():
        for index, time in enumerate(lidar.timestamps_us.tolist()):
            if not track.trajectory.covers(time):
                continue
            object_from_rig = se3.inverse(track.trajectory.at(time)) @ log.world_from_rig.at(time)
            origin = se3.apply(object_from_rig, lidar.rig_from_lidar[:3, 3][None])[0]
            ends = se3.apply(object_from_rig, _towards(lidar.sweeps[index].points, object_from_rig))
            passed += _crossed(origin, ends, half, shape)
    free = np.flatnonzero(passed >= _RAYS)
    centres = (np.stack(np.unravel_index(free, shape), -1) + 0.5) * EDGE - half
    if len(hits) and len(centres):
        distance, _ = cKDTree(hits).query(centres)
        centres = centres[distance > _NEAR_HIT]
    return FreeSpace(centres.astype(np.float32).reshape(-1, 3))


def _towards(points: NDArray[np.float32], object_from_rig: Array) -> Array:
    """Those points (N, 3) of a sweep, rig frame, that lie on the box's side of the rig."""
    middle = se3.inverse(object_from_rig)[:3, 3]
    distance = float(np.linalg.norm(middle))
    cosine = points @ (middle / max(distance, 1e-9)) / np.linalg.norm(points, axis=1).clip(1e-9)
    # half the diagonal of a long vehicle, seen from its distance
    widest = np.cos(min(np.arctan2(8.0, distance) + 0.05, np.pi / 2))
    return np.asarray(points[cosine > widest], np.float64)


def _crossed(origin: Array, ends: Array, half: Array, shape: Array) -> NDArray[np.int64]:
    """How many rays that end beyond the box pass each cell, (C,) by flat index."""
    step = ends - origin
    length = np.linalg.norm(step, axis=1)
    enter, leave = crossing(origin, step, -half, half)
    through = (enter < leave) & (enter > 0) & (leave < 1 - _BEHIND / length.clip(1e-9))
    enter, leave, step = enter[through], leave[through], step[through]
    counts = ((leave - enter) * length[through] / (0.5 * EDGE)).astype(np.int64) + 1
    ray = np.repeat(np.arange(len(counts)), counts)
    along = (np.arange(len(ray)) - np.repeat(np.cumsum(counts) - counts, counts)).astype(np.float64)
    along *= ((leave - enter) / np.maximum(counts - 1, 1))[ray]
    points = origin + (enter[ray] + along)[:, None] * step[ray]
    cells = np.floor((points + half) / EDGE).astype(np.int64).clip(0, shape - 1)
    flat = np.ravel_multi_index(tuple(cells.T), tuple(shape))
    # a straight ray is in a cell once, so its places in one cell follow each other
    first = np.ones(len(flat), bool)
    first[1:] = (flat[1:] != flat[:-1]) | (ray[1:] != ray[:-1])
    return np.bincount(flat[first], minlength=int(np.prod(shape)))


@dataclass(frozen=True)
class VisualHull:
    """Cells that the masks agree on."""

    centres: Array  # (M, 3) centres of the solid cells, object frame, metres
    edge: float  # edge length of a cell, metres

    def outline(self, sighting: Sighting) -> Float32Array:
        """Its silhouette (H, W) in [0, 1] in an image."""
        height, width = sighting.mask.shape
        drawn = np.zeros((height, width), np.uint8)
        points = se3.apply(sighting.camera_from_object, self.centres)
        points = points[points[:, 2] > 0.1]
        if len(points):
            pixels, depth = sighting.camera.project(points)
            # Squares as wide as a cell seen along its diagonal leave no gaps between them.
            side = max(round(float(1.2 * self.edge * sighting.camera.fx / np.median(depth))), 1)
            u, v = np.floor(pixels).astype(int).T
            inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
            drawn[v[inside], u[inside]] = 1
            drawn = np.asarray(cv2.dilate(drawn, np.ones((side, side), np.uint8)), np.uint8)
        return drawn.astype(np.float32)


def carve(sightings: Sequence[Sighting], size: Array) -> VisualHull:
    """The cells of the box that most of the images which see them have in their masks."""
    half = size / 2 * (1 + _WIDER)
    edge = float(2 * half[0] / _CELLS)
    axes = [np.arange(-h + edge / 2, h, edge) for h in half]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    total, inside = np.zeros(len(centres)), np.zeros(len(centres))
    for sighting in sightings:
        height, width = sighting.mask.shape
        points = se3.apply(sighting.camera_from_object, centres)
        pixels, depth = sighting.camera.project(points)
        u, v = np.floor(pixels).astype(int).T
        seen = (u >= 0) & (u < width) & (v >= 0) & (v < height) & (depth > 0.1)
        weight = sighting.weight * sighting.trust[v[seen], u[seen]]
        total[seen] += weight
        inside[seen] += weight * sighting.mask[v[seen], u[seen]]
    solid = (total > 0) & (inside > _SOLID * total)
    return VisualHull(centres[solid], edge)


def settle_masks(
    sightings: Sequence[Sighting], size: Array
) -> tuple[list[Sighting], list[Sighting]]:
    """The sightings with their trust lowered where mask and visual hull differ.

    Args:
        size: (3,) size of the box, metres.

    Returns:
        Sightings that agree with the others, and sightings that do not: their masks overlap with
        the hull's outline by less than half.
    """
    hull = carve(sightings, size)
    kept, refused = [], []
    for sighting in sightings:
        outline = hull.outline(sighting)
        mask = sighting.mask > 0.5
        seen = sighting.trust > 0
        union = float(((outline > 0) | mask)[seen].sum())
        both = float(((outline > 0) & mask)[seen].sum())
        agreement = both / union if union else 0.0
        if agreement < LEAST_AGREEMENT:
            refused.append(sighting)
            continue
        differs = (outline > 0.5) != mask
        trust = sighting.trust * np.where(differs, np.float32(_DOUBT), np.float32(1))
        kept.append(replace(sighting, trust=trust.astype(np.float32)))
    return kept, refused


EVIDENCE_VERSION = 1
_MEND = "make the actor again"
_POSES = ("camera_from_world", "world_from_object")


@dataclass(frozen=True)
class Sighting:
    """One image of a log that shows the vehicle, cut to the vehicle and its surroundings."""

    # camera_name, frame, timestamp_us: camera, frame number and log time of the image.
    camera_name: str
    frame: int
    timestamp_us: int
    camera: PinholeCamera  # pinhole of the crop, without distortion
    # (4, 4), with the correction that a scene has learned, if there is one.
    camera_from_world: Array
    world_from_object: Array  # (4, 4); object frame: box centre, x forward, y left, z up
    image: NDArray[np.uint8]  # (H, W, 3) uint8 RGB
    mask: Float32Array  # (H, W) float32 in [0, 1], 1 on the vehicle
    # (H, W) float32 in [0, 1]: how far `mask` is believed; 0 where something hides the vehicle or
    # the image is not usable.
    trust: Float32Array
    weight: float  # weight in [0, 1] of the image beside the others: size, sharpness, occlusion

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
    """All that a log knows of a vehicle; held-out images are not in it."""

    # track_id, category: id and category of the track.
    track_id: str
    category: str
    size: Array  # (3,) length, width, height of the logged box, metres
    sightings: tuple[Sighting, ...]  # sightings in order of time
    hits: Float32Array  # (N, 3) float32 LiDAR points on the vehicle, object frame
    free: FreeSpace  # cells of the box that LiDAR rays passed through
    # why images that show the box are not among the sightings, one entry an image.
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
    """Write evidence to a file, whole or not at all; masks and trust are kept in 255ths. Raises
    InputError: the disk refuses."""
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
    """Read an evidence file. Raises InputError: missing, broken, of another version, or with values
    that no evidence has."""
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
