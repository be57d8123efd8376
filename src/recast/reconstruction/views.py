"""What a training looks at: images at its scales, posed and split; tracks that become actors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor

from recast.arrays import Array, Float32Array, Image, Mask
from recast.cameras import PinholeCamera, box_rectangle
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, Track, Trajectory, all_track_points
from recast.logs.types import PEOPLE
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.settings import INIT
from recast.scene.street_scene import DEFORMABLE, moves, pose_at, stands


@dataclass(frozen=True)
class TrainingView:
    """One posed image.

    Attributes:
        camera_name: stream in the log.
        frame: index in that stream.
        timestamp_us: time of the exposure.
        camera: intrinsics of `image`, rectified.
        world_from_camera: (4, 4) as logged.
        image: (H, W, 3) uint8 RGB; (0, 0, 3) where it was not read.
        mask: (H, W) bool, False where the image is never usable, or None.
        held_out: whether the view is kept from training and from everything that leads to it.
    """

    camera_name: str
    frame: int
    timestamp_us: int
    camera: PinholeCamera
    world_from_camera: Array
    image: Image = field(default_factory=lambda: np.zeros((0, 0, 3), np.uint8))
    mask: Mask | None = None
    held_out: bool = False

    @property
    def camera_from_world(self) -> Array:
        """(4, 4), as logged."""
        return se3.inverse(self.world_from_camera)


def camera_names(log: DrivingLog, config: SceneConfig) -> tuple[str, ...]:
    """The cameras asked for, or all.

    Raises:
        InputError: a camera that the log does not have, or a log without cameras.
    """
    if not log.cameras:
        raise InputError(log.name, "cameras", "the log has none", "import a log with images")
    for name in config.cameras:
        if name not in log.cameras:
            raise InputError(
                log.name,
                f"camera {name}",
                "is not in the log",
                f"choose one of {sorted(log.cameras)}",
            )
    return config.cameras or tuple(log.cameras)


def is_held_out(frame: int, config: SceneConfig) -> bool:
    """Whether frame `frame` of every camera is kept for evaluation."""
    every = config.holdout_every
    return every > 0 and frame % every == config.holdout_offset % every


def read_places(log: DrivingLog, config: SceneConfig) -> list[TrainingView]:
    """`read_views` without the images: where and when each was taken."""
    return [
        _place(log, log.cameras[name], frame, config.scale, is_held_out(frame, config))
        for name in camera_names(log, config)
        for frame in range(len(log.cameras[name].timestamps_us))
    ]


def read_views(log: DrivingLog, config: SceneConfig) -> list[TrainingView]:
    """All views of the chosen cameras, camera by camera, in order of time.

    A camera's views share one mask, which hangs on lens and mount; not so frames with hidden parts.
    """
    views = []
    for name in camera_names(log, config):
        mask = None
        for frame in range(len(log.cameras[name].timestamps_us)):
            held_out = is_held_out(frame, config)
            view = read_view(log, log.cameras[name], frame, config.scale, held_out)
            if frame not in log.cameras[name].hidden:
                mask = view.mask if mask is None else mask
                view = replace(view, mask=mask)
            views.append(view)
    return views


def read_view(
    log: DrivingLog, stream: CameraStream, frame: int, scale: float, held_out: bool = False
) -> TrainingView:
    """Decode, rectify and scale one frame."""
    full = stream.camera
    image: Image = np.ascontiguousarray(stream.images[frame])
    mask = stream.mask
    if not full.is_rectified:
        mask = np.ones(image.shape[:2], bool) if mask is None else mask  # unusable from outside
        across, down = _source_pixels(full)
        edge = cv2.BORDER_REPLICATE
        image = np.asarray(cv2.remap(image, across, down, cv2.INTER_LINEAR, borderMode=edge))
    place = _place(log, stream, frame, scale, held_out)
    if scale != 1.0:
        size = (place.camera.width, place.camera.height)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    fitted = None if mask is None else fit_mask(full, mask, scale)
    if frame in stream.hidden:
        fitted = np.ones(image.shape[:2], bool) if fitted is None else fitted
        low = np.floor(np.array(stream.hidden[frame][:2]) * scale).clip(0).astype(int)
        high = np.ceil(np.array(stream.hidden[frame][2:]) * scale).clip(0).astype(int)
        fitted[low[1] : high[1], low[0] : high[0]] = False
    return replace(place, image=image, mask=fitted)


def _place(
    log: DrivingLog, stream: CameraStream, frame: int, scale: float, held_out: bool
) -> TrainingView:
    timestamp_us = int(stream.timestamps_us[frame])
    return TrainingView(
        camera_name=stream.name,
        frame=frame,
        timestamp_us=timestamp_us,
        camera=scaled_camera(stream.camera, scale),
        world_from_camera=log.world_from_rig.at(timestamp_us) @ stream.rig_from_camera,
        held_out=held_out,
    )


def scaled_camera(camera: PinholeCamera, scale: float) -> PinholeCamera:
    """The rectified camera of the image scaled by `scale`, its size rounded to whole pixels."""
    width, height = round(camera.width * scale), round(camera.height * scale)
    return camera.rectified().resized(max(1, width), max(1, height))


def nearest_views(
    views: Sequence[TrainingView], timestamp_us: int, limit_us: int
) -> Iterator[TrainingView]:
    """The view of each camera nearest in time, where it is within `limit_us`."""
    for name in dict.fromkeys(view.camera_name for view in views):
        own = [view for view in views if view.camera_name == name]
        best = min(own, key=lambda view: abs(view.timestamp_us - timestamp_us))
        if abs(best.timestamp_us - timestamp_us) <= limit_us:
            yield best


def fit_mask(camera: PinholeCamera, mask: Mask, scale: float) -> Mask:
    """A mask (H, W) of the recorded image as it lies on its view: rectified and scaled."""
    fitted = mask.astype(np.uint8)
    if not camera.is_rectified:  # pixels from outside the recorded image: 0
        fitted = np.asarray(cv2.remap(fitted, *_source_pixels(camera), cv2.INTER_NEAREST), np.uint8)
    target = scaled_camera(camera, scale)
    size = (target.width, target.height)
    return cv2.resize(fitted, size, interpolation=cv2.INTER_NEAREST) > 0


@lru_cache(maxsize=1)  # a camera's images come one after the other
def _source_pixels(camera: PinholeCamera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Where OpenCV finds the pixels (H, W) of the rectified image in the recorded one: x and y."""
    target = camera.rectified()
    pixels, _ = camera.project(target.rays(target.pixel_grid()))
    found = pixels.astype(np.float32) - np.float32(0.5)  # it puts centres at whole numbers
    return found[..., 0], found[..., 1]


@dataclass(frozen=True)
class DepthSamples:
    """LiDAR depth of one view.

    Attributes:
        depths: (M,) float32 metres along the camera's z axis.
        uv: (M, 2) float32 pixel coordinates, inside the image.
    """

    depths: Float32Array
    uv: Float32Array


def near_samples(view: TrainingView, samples: DepthSamples) -> Mask:
    """Pixels (H, W) within a few pixels of a LiDAR return."""
    hit = np.zeros((view.camera.height, view.camera.width), np.uint8)
    hit[samples.uv[:, 1].astype(np.int64), samples.uv[:, 0].astype(np.int64)] = 1
    size = 2 * INIT.lidar_reach_px + 1
    return cv2.dilate(hit, np.ones((size, size), np.uint8)) > 0


@dataclass(frozen=True)
class Level:
    """What the losses of one view need.

    Attributes:
        camera: intrinsics at this resolution.
        K: (3, 3) float32, on the CPU, where its numbers are read.
        target: (H, W, 3) float32 in [0, 1], unusable pixels black.
        usable: (H, W, 1) float32 0 or 1, or None where every pixel counts.
        sky: (S,) int64 flat indices of sure sky pixels.
        ground: (G,) int64 flat indices of pixels that are surely none, where a loss asks for them.
        depth_pixels: (M,) int64 flat indices; depths: (M,) float32 metres.
    """

    camera: PinholeCamera
    K: Tensor
    target: Tensor
    usable: Tensor | None
    sky: Tensor
    ground: Tensor
    depth_pixels: Tensor
    depths: Tensor


@dataclass(frozen=True)
class StoredLevel:
    """A level that waits: `unpacked` gives its tensors.

    Attributes:
        camera: intrinsics at this resolution.
        image: (H, W, 3) uint8.
        usable, sky, ground: masks of H W pixels as bits; see `Level`.
        depth_pixels: (M,) int32; depths: (M,) float32.
    """

    camera: PinholeCamera
    image: NDArray[np.uint8]
    usable: NDArray[np.uint8] | None
    sky: NDArray[np.uint8]
    ground: NDArray[np.uint8]
    depth_pixels: NDArray[np.int32]
    depths: NDArray[np.float32]

    def unpacked(self, device: torch.device | str = "cpu") -> Level:
        """The level on a device; a few float images, to be dropped after the step."""
        target = torch.from_numpy(self.image).to(device).to(torch.float32) * (1 / 255)
        usable = None
        if self.usable is not None:
            bits = self._unpacked(self.usable).reshape(self.camera.height, self.camera.width, 1)
            usable = torch.from_numpy(bits).to(device).to(torch.float32)
            target = target * usable
        return Level(
            camera=self.camera,
            K=torch.from_numpy(self.camera.matrix).float(),
            target=target,
            usable=usable,
            sky=torch.from_numpy(np.flatnonzero(self._unpacked(self.sky))).to(device),
            ground=torch.from_numpy(np.flatnonzero(self._unpacked(self.ground))).to(device),
            depth_pixels=torch.from_numpy(self.depth_pixels).to(device).to(torch.int64),
            depths=torch.from_numpy(self.depths).to(device),
        )

    def _unpacked(self, bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return np.unpackbits(bits, count=min(8 * len(bits), self.camera.width * self.camera.height))


def make_level(
    view: TrainingView, sky: Mask, ground: Mask | None, samples: DepthSamples, factor: int = 1
) -> StoredLevel:
    """The view with width and height divided by `factor`.

    Args:
        sky, ground: (H, W) masks of the view; no ground is kept where it is None.
        samples: LiDAR depths, thinned evenly to `most_depths`.
    """
    camera, image, usable, uv = view.camera, view.image, view.mask, samples.uv
    if factor > 1:
        width, height = max(1, camera.width // factor), max(1, camera.height // factor)
        size = (width, height)
        uv = uv * np.array([width / camera.width, height / camera.height], np.float32)
        camera = camera.resized(width, height)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        usable = None if usable is None else _wholly(usable, size)
        sky = _wholly(sky, size)
        ground = None if ground is None else _wholly(ground, size)
    step = max(1, -(-len(samples.depths) // INIT.most_depths))
    uv, depths = uv[::step], samples.depths[::step]
    columns = np.minimum(uv[:, 0].astype(np.int32), camera.width - 1)
    rows = np.minimum(uv[:, 1].astype(np.int32), camera.height - 1)
    return StoredLevel(
        camera=camera,
        image=image,
        usable=None if usable is None else np.packbits(usable),
        sky=np.packbits(sky),
        ground=np.zeros(0, np.uint8) if ground is None else np.packbits(ground),
        depth_pixels=rows * np.int32(camera.width) + columns,
        depths=np.ascontiguousarray(depths),
    )


def _wholly(mask: Mask, size: tuple[int, int]) -> Mask:
    """Pixels of the smaller image that lie in the mask altogether."""
    area = cv2.resize(mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
    return area == 255


def make_levels(
    config: SceneConfig,
    views: Sequence[TrainingView],
    sky_pixels: Sequence[NDArray[np.int64]],
    depths: Sequence[DepthSamples],
) -> dict[int, list[StoredLevel]]:
    """By factor of `schedule.coarse_factor`, the training views in order.

    Args:
        sky_pixels, depths: of each view, see `Initialisation`.
    """
    factors = set(config.coarse_factors) if config.coarse_fraction > 0 else set()
    levels: dict[int, list[StoredLevel]] = {factor: [] for factor in sorted(factors | {1})}
    for view, pixels, samples in zip(views, sky_pixels, depths, strict=True):
        sky = np.zeros((view.camera.height, view.camera.width), bool)
        sky.reshape(-1)[pixels] = True
        ground = _ground(config, view, sky, samples)
        for factor, own in levels.items():
            own.append(make_level(view, sky, ground, samples, factor))
    return levels


def _ground(
    config: SceneConfig, view: TrainingView, sky: Mask, samples: DepthSamples
) -> Mask | None:
    """Pixels that are surely no sky: all others, as far as they count.

    The guessed sky errs on the small side; then only pixels near a LiDAR return are sure.
    """
    if config.sky_loss != "entropy" and config.solid_weight == 0:
        return None
    ground = ~sky if view.mask is None else view.mask & ~sky
    return ground & near_samples(view, samples) if config.sky_mask == "heuristic" else ground


def deforms(track: Track, config: SceneConfig) -> bool:
    """Whether an actor is a deformable node: with `deformable`, people and riders that move."""
    moving = not stands(track.trajectory)
    return config.deformable and track.category in (*PEOPLE, "motorcyclist") and moving


def visible_rectangle(size: Array, world_from_box: Array, view: TrainingView) -> Array | None:
    """Image rectangle (left, top, right, bottom) of a box, clipped to the image; None if unseen."""
    camera = view.camera
    rectangle = box_rectangle(size, view.camera_from_world @ world_from_box, camera)
    if rectangle is None:
        return None
    limits = [camera.width, camera.height, camera.width, camera.height]
    clipped: Array = np.clip(rectangle, 0, limits)
    if clipped[2] - clipped[0] < 1 or clipped[3] - clipped[1] < 1:
        return None
    return clipped


def choose_actors(
    log: DrivingLog, views: Sequence[TrainingView], config: SceneConfig
) -> Mapping[str, Track]:
    """Tracks that get a model of their own: moving, parked or forced ones.

    A moving or forced track is one that is seen in at least one view. A parked vehicle is one that
    was labelled for `parked_us` and seen well enough: by `parked_views` views in which its box is
    `parked_pixels` wide and high, and where there is a LiDAR, by `parked_points` points. It stands
    at the median of its labels from the log's first pose to its last, since labels of what stands
    still differ by their noise alone.

    Raises:
        InputError: a forced or excluded track is not in the log, or a forced one is never visible.
    """
    for setting in ("force_dynamic", "exclude_tracks"):
        for track_id in getattr(config, setting):
            if track_id not in log.tracks:
                raise InputError(
                    log.name,
                    f"{setting}: track {track_id}",
                    "is not in the log",
                    f"choose one of {', '.join(sorted(log.tracks)) or 'none'}",
                )
    parked = _parked(log, views, config)
    chosen = {}
    for track_id, track in log.tracks.items():
        if track_id in config.exclude_tracks:
            continue
        forced = track_id in config.force_dynamic
        if track_id in parked:
            chosen[track_id] = parked[track_id]
        elif not (forced or moves(track.trajectory)):
            continue
        elif any(_rectangle(track, view) is not None for view in views):
            chosen[track_id] = track
        elif forced:
            raise InputError(
                log.name,
                f"force_dynamic: track {track_id}",
                "is never visible in the cameras used",
                "choose another track or other cameras",
            )
    return chosen


def modelled_tracks(log: DrivingLog, config: SceneConfig) -> frozenset[str]:
    """Ids of the tracks that a scene of this configuration models, see `choose_actors`."""
    return frozenset(choose_actors(log, read_places(log, config), config))


def _parked(
    log: DrivingLog, views: Sequence[TrainingView], config: SceneConfig
) -> dict[str, Track]:
    candidates = {
        track_id: track
        for track_id, track in log.tracks.items()
        if track.category not in DEFORMABLE
        and not moves(track.trajectory)
        and np.ptp(track.trajectory.timestamps_us) >= INIT.parked_us
        and _seen_well(track, views)
    }
    if log.lidars and candidates:
        points = all_track_points(log, candidates)
        hit = {key for key, own in points.items() if len(own.points) >= INIT.parked_points}
        candidates = {key: track for key, track in candidates.items() if key in hit}
    ends = log.world_from_rig.timestamps_us[[0, -1]]
    return {
        key: replace(track, trajectory=_standing(track.trajectory, ends))
        for key, track in candidates.items()
    }


def _standing(trajectory: Trajectory, ends: NDArray[np.int64]) -> Trajectory:
    """The median pose, at the first and the last time."""
    pose = trajectory.poses[0].copy()
    pose[:3, 3] = np.median(trajectory.poses[:, :3, 3], axis=0)
    pose[:3, :3] = Rotation.from_matrix(trajectory.poses[:, :3, :3]).mean().as_matrix()
    return Trajectory(ends.copy(), np.stack([pose, pose]))


def _seen_well(track: Track, views: Sequence[TrainingView]) -> bool:
    rectangles = (_rectangle(track, view) for view in views if not view.held_out)
    sides = [np.ptp(one.reshape(2, 2), axis=0) for one in rectangles if one is not None]
    return sum(bool(np.all(side >= INIT.parked_pixels)) for side in sides) >= INIT.parked_views


def _rectangle(track: Track, view: TrainingView) -> Array | None:
    pose = pose_at(track.trajectory, view.timestamp_us)
    return None if pose is None else visible_rectangle(track.size, pose, view)
