"""What generated vehicles are judged on, and how alike a drawn vehicle and its photograph are.

A case has a picture to make a vehicle from and views to compare with: those of the set, or the
paper's orbit. The paper (section 5, Q3) renders target views with an angle of view of 40 degrees, a
pitch of 15 and azimuths of 0, 90, 180 and 270 degrees. That fits the camera of the published
image-to-3D code (512 x 512 pixels, radius 2 about a vehicle whose longest side is 1). How
photographs were brought to these views it does not say; here they are scaled about their centre,
see `orbit_case`."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from recast.actors import Observation
from recast.actors.evidence import Sighting
from recast.actors.insert import draw
from recast.actors.observe import observation_of_view
from recast.arrays import Array, Image, Mask
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.metrics.oracle_scores import actor_mask, grown, mask_iou
from recast.metrics.perceptual import ImageDistance
from recast.recar import RealView, holds_real_crops, read_real_crops
from recast.recar.vehicle_set import SET_FILE, Identity, read_set
from recast.recar.views import FOV_DEG, pinhole
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.evaluate import MIN_BOX_PX, draw_view
from recast.reconstruction.scores import Rectangle, capped_psnr, ssim, ssim_map
from recast.reconstruction.views import (
    TrainingView,
    camera_names,
    is_held_out,
    read_view,
    visible_rectangle,
)
from recast.scene import SceneRasterizer, StreetScene
from recast.scene.street_scene import pose_at
from recast.splats import Gaussians, LowPass

Targets = Literal["set", "orbit"]
"""`set`: the cameras of the photographs; `orbit`: the paper's."""

TARGET_AZIMUTHS = (0.0, 90.0, 180.0, 270.0)
"""Degrees of the views that a vehicle of a set is judged by (the paper, section 5, Q3)."""
ORBIT_PIXELS = 512
ORBIT_RADIUS = 2.0
"""Distance of the orbit's camera from the box centre, in longest sides of the box."""
_ASIDE = 1e-3  # of the distance, by which a camera may look past the box centre


@dataclass(frozen=True)
class ActorView:
    """A background-free picture of a vehicle and its camera; can be sent to other processes.

    Attributes:
        load: function that gives (H, W, 4) uint8, straight alpha; raises InputError.
        camera: camera without distortion.
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
        category: category of its label, see `recast.logs.Track`.
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
        folder: see `recast.recar.read_real_crops`, or `recast.recar.read_set`.
        limit: take only the first vehicles, sorted by id.
        views: number of inputs of a set's vehicle, at most.

    Raises:
        InputError: the folder is neither, or holds nothing to judge; `limit` or `views` below 1;
            what the readers refuse.
    """
    folder = Path(folder)
    for option, value in (("`limit`", limit), ("`views`", views)):
        if value is not None and value < 1:
            raise InputError(option, "value", f"is {value}", "give 1 or more")
    if not folder.is_dir():
        raise InputError(folder, "set", "is not a folder", "check the path")
    if (folder / SET_FILE).exists():
        vehicles = read_set(folder)
        held_out = list(vehicles.of_split("held-out"))[:limit]
        cases = [_case_of_identity(folder, identity, seed, views) for identity in held_out]
        if not cases:
            raise InputError(folder, "held-out", "contains no vehicle", "use a larger set")
        return cases
    if not holds_real_crops(folder):
        raise InputError(
            folder,
            "set",
            f"has no {SET_FILE} and no ID/input_views",
            "give a folder of vehicles; see docs/data.md#vehicle-sets",
        )
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


def _case_of_identity(folder: Path, identity: Identity, seed: int, views: int) -> ActorCase:
    record, shared = identity.record, identity.set_record
    where = folder / record.id
    if record.size is None:
        raise InputError(
            where, "size", "is null", "measure the vehicles: placing them needs the size"
        )
    targets = list(dict.fromkeys(_nearest(shared.azimuths_deg, goal) for goal in TARGET_AZIMUTHS))
    others = [index for index in range(shared.views) if index not in targets]
    # by name, not by place in the list: a set that grows keeps the inputs of all it had
    rng = np.random.default_rng([seed, zlib.crc32(record.id.encode())])
    chosen = int(rng.choice(others or targets))
    reserved = [index for index in targets if index != chosen]
    if not reserved:
        raise InputError(where, "views", "is 1", "use a set with several views of each vehicle")
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


def _view_of_set(where: Path, identity: Identity, index: int) -> ActorView:
    try:
        camera, actor_from_camera = identity.camera(index)
    except ValueError as error:
        raise InputError(where, "camera", str(error), "use a set with measured cameras") from None
    return ActorView(
        f"view_{index:02d}", partial(identity.view, index), camera, se3.inverse(actor_from_camera)
    )


def target_case(case: ActorCase, targets: Targets) -> ActorCase:
    """The case with the views that are asked for; InputError: see `orbit_case`."""
    return orbit_case(case) if targets == "orbit" else case


def orbit_case(case: ActorCase) -> ActorCase:
    """The case with its targets seen from the orbit: 512 x 512 pixels, 40 degrees, radius 2.

    A view keeps the direction of its photograph. The photograph is scaled about its centre so that
    lengths at the box centre are those of the orbit's picture; its perspective stays that of its
    own distance. Beyond its edges there is nothing.

    Raises:
        InputError: a camera that does not look at the box centre.
    """
    radius = ORBIT_RADIUS * float(case.size.max())
    return replace(case, targets=tuple(_orbit_view(case.id, one, radius) for one in case.targets))


def _orbit_view(id: str, view: ActorView, radius: float) -> ActorView:
    right, down, distance = view.camera_from_actor[:3, 3]
    middle = abs(view.camera.cx - view.camera.width / 2) + abs(
        view.camera.cy - view.camera.height / 2
    )
    if max(abs(right), abs(down)) > _ASIDE * distance or middle > 1.0:
        raise InputError(
            f"{id}/{view.name}",
            "camera",
            "does not look at the box centre",
            "compare in the set's own views (`targets` set)",
        )
    camera = pinhole(ORBIT_PIXELS, ORBIT_PIXELS, FOV_DEG)
    pose = view.camera_from_actor.copy()
    pose[:3, 3] = (0.0, 0.0, radius)
    scale = (view.camera.fx / distance) / (camera.fx / radius)
    load = partial(_scaled, view.load, float(scale), (view.camera.cx, view.camera.cy))
    return replace(view, load=load, camera=camera, camera_from_actor=pose)


def _scaled(load: Callable[[], Image], scale: float, centre: tuple[float, float]) -> Image:
    """A picture about its centre, `scale` of its pixels a pixel of the orbit's: straight alpha.

    Colours are weighed by alpha. Several samples a pixel, so that none of the picture is missed.
    """
    rgba = load()
    alpha = rgba[..., 3:].astype(np.float32) / 255
    light = np.concatenate([rgba[..., :3] * (alpha / 255), alpha], axis=2)
    samples = max(1, math.ceil(scale))
    total = np.zeros((ORBIT_PIXELS, ORBIT_PIXELS, 4), np.float64)
    offsets = (np.arange(samples) + 0.5) / samples - ORBIT_PIXELS / 2
    for right in offsets:
        for down in offsets:
            # OpenCV counts pixel centres from 0, our cameras from one half
            shift = [centre[0] + scale * right - 0.5, centre[1] + scale * down - 0.5]
            matrix = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
            total += cv2.warpAffine(
                light,
                matrix,
                (ORBIT_PIXELS, ORBIT_PIXELS),
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_CONSTANT,
            )
    mean = total / samples**2
    colour = mean[..., :3] / np.maximum(mean[..., 3:], 1e-6)
    found = np.concatenate([colour, mean[..., 3:]], axis=2)
    return np.clip(np.round(255 * found), 0, 255).astype(np.uint8)


def case_observation(case: ActorCase, view: ActorView, rgba: Image | None = None) -> Observation:
    """What a generator is given of a view: its own picture, or another one (H, W, 4)."""
    return observation_of_view(
        view.load() if rgba is None else rgba,
        view.camera,
        view.camera_from_actor,
        case.size,
        name=f"{case.id}/{view.name}",
        category=case.category,
    )


def elevation_deg(view: ActorView) -> float:
    """Degrees of a view's camera above the horizontal through the box centre."""
    eye = -view.camera_from_actor[:3, :3].T @ view.camera_from_actor[:3, 3]
    return float(np.degrees(np.arctan2(eye[2], np.hypot(eye[0], eye[1]))))


_MARGIN = 24  # pixels around the box: more than half an SSIM window, and to look at
_GAP = 4


@dataclass(frozen=True)
class ActorColumn:
    """How a score is shown.

    Attributes:
        higher: whether a higher one is better.
    """

    label: str
    unit: str
    higher: bool
    decimals: int

    def shown(self, value: float) -> str:
        """The score in text."""
        return f"{value:.{self.decimals}f}"


ACTOR_COLUMNS: Mapping[str, ActorColumn] = {
    "psnr": ActorColumn("PSNR", "dB", True, 2),
    "psnr_vehicle": ActorColumn("PSNR vehicle", "dB", True, 2),
    "ssim": ActorColumn("SSIM", "", True, 4),
    "mask_iou": ActorColumn("mask IoU", "", True, 3),
    "lpips": ActorColumn("LPIPS", "", False, 4),
    "clip": ActorColumn("CLIP image", "x100", True, 2),
    "dino": ActorColumn("DINO distance", "", False, 4),
}
"""Scores in the order of the table; the last three only where weights were given."""


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels; it may reach beyond the image.

    Attributes:
        top, left: row and column of its first pixel; negative above and left of the image.
        height, width: size in pixels.
    """

    top: int
    left: int
    height: int
    width: int

    def of(self, image: Array) -> Array:
        """What an image (H, W, ...) shows in the window (height, width, ...); zeros beyond it."""
        seen = np.zeros((self.height, self.width, *image.shape[2:]), image.dtype)
        bottom, right = self.top + self.height, self.left + self.width
        part = image[max(self.top, 0) : max(bottom, 0), max(self.left, 0) : max(right, 0)]
        top, left = max(-self.top, 0), max(-self.left, 0)
        seen[top : top + part.shape[0], left : left + part.shape[1]] = part
        return seen


@dataclass(frozen=True)
class ScoredCutout:
    """A vehicle before black.

    Attributes:
        rgb: (H, W, 3) float64 display values in [0, 1], multiplied by alpha.
        alpha: (H, W) float64 in [0, 1].
    """

    rgb: Array
    alpha: Array

    @property
    def mask(self) -> Mask:
        """(H, W) pixels covered by more than half."""
        return self.alpha > 0.5

    def before(self, grey: float) -> Array:
        """(H, W, 3) with that grey behind it."""
        return np.clip(self.rgb + (1 - self.alpha[..., None]) * grey, 0.0, 1.0)

    def within(self, window: Window) -> ScoredCutout:
        """The part in a window; beyond the image there is nothing, as around the vehicle."""
        return ScoredCutout(window.of(self.rgb), window.of(self.alpha))


def photographed(rgba: NDArray[np.uint8]) -> ScoredCutout:
    """A picture (H, W, 4) with straight alpha as a cutout."""
    alpha = rgba[..., 3].astype(np.float64) / 255
    return ScoredCutout(rgba[..., :3] / 255 * alpha[..., None], alpha)


def drawn(gaussians: Gaussians, low_pass: LowPass, view: ActorView) -> ScoredCutout:
    """Gaussians in the actor frame as the camera of a view sees them, by their own filter."""
    with torch.no_grad():
        picture = draw(gaussians, view.camera_from_actor, view.camera, low_pass)
    return ScoredCutout(
        picture.rgb.clamp(0, 1).numpy().astype(np.float64),
        picture.alpha.clamp(0, 1).numpy().astype(np.float64),
    )


def score_view(
    shown: ScoredCutout, truth: ScoredCutout, distances: Sequence[ImageDistance] = ()
) -> dict[str, float]:
    """Scores by key of `ACTOR_COLUMNS`.

    PSNR and SSIM are those of the whole image before black; PSNR of the vehicle is that over the
    pixels of either mask. PSNR is at most 100 dB.

    Args:
        shown, truth: render and photograph of one size.
        distances: further measures, each under its own key.
    """
    either = shown.mask | truth.mask
    scores = {
        "psnr": capped_psnr(shown.rgb, truth.rgb),
        "psnr_vehicle": capped_psnr(shown.rgb[either], truth.rgb[either]),
        "ssim": ssim(shown.rgb, truth.rgb),
        "mask_iou": mask_iou(shown.mask, truth.mask),
    }
    for distance in distances:
        window = framed(truth.mask) if distance.framed else Window(0, 0, *truth.mask.shape)
        scores[distance.key] = distance(window.of(shown.rgb), window.of(truth.rgb))
    return scores


def framed(mask: Mask, margin: float = 0.1) -> Window:
    """A square around a mask (H, W), whole even where the mask reaches the image's edge.

    Args:
        mask: mask with at least one pixel.
        margin: share of the mask's longer side left free on every side.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    low = np.array([rows[0], columns[0]])
    high = np.array([rows[-1], columns[-1]]) + 1
    side = int(np.ceil(np.max(high - low) * (1 + 2 * margin)))
    top, left = np.floor((low + high - side) / 2).astype(int)
    return Window(int(top), int(left), side, side)


def mean_scores(scores: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Mean of every score over views, or over vehicles; all have the same keys."""
    return {key: float(np.mean([one[key] for one in scores])) for key in scores[0]}


@dataclass(frozen=True)
class TrackView:
    """One held-out image of a track.

    Attributes:
        rectangle: rectangle of the box, whole pixels.
        psnr: dB in the rectangle by model, at most 100.
        ssim: mean over the rectangle by model.
        mask_iou: overlap of the vehicle's outline with its mask by model; empty without masks.
        lpips: distance in the rectangle by model; empty without weights.
        picture: (H, W, 3) box and margin: the recording, then each model.
    """

    camera: str
    frame: int
    timestamp_us: int
    rectangle: Rectangle
    psnr: dict[str, float]
    ssim: dict[str, float]
    picture: Image
    mask_iou: dict[str, float] = field(default_factory=dict)
    lpips: dict[str, float] = field(default_factory=dict)


def held_out_track(
    log: DrivingLog,
    track_id: str,
    config: SceneConfig,
    models: Mapping[str, StreetScene],
    *,
    masks: Mapping[tuple[str, int], Sighting] | None = None,
    distance: ImageDistance | None = None,
) -> Iterator[TrackView]:
    """Score the held-out images that show a track well enough, in which nothing is moved.

    Args:
        config: configuration of the scenes' training: cameras, scale and split.
        models: scenes by name, each with a model of the track. The first one's poses say where the
            box is.
        masks: images of the track with masks, by camera and frame: then these are scored instead.
        distance: LPIPS.

    Yields:
        an image after the other, camera by camera.
    """
    rasterizers = {name: SceneRasterizer(scene) for name, scene in models.items()}
    own = next(iter(models.values())).actors[track_id]
    for name in camera_names(log, config):
        stream = log.cameras[name]
        for frame in range(len(stream.timestamps_us)):
            pose = pose_at(own.trajectory, int(stream.timestamps_us[frame]))
            chosen = is_held_out(frame, config) if masks is None else (name, frame) in masks
            if pose is None or not chosen:
                continue
            view = read_view(log, stream, frame, config.scale, held_out=True)
            outline = visible_rectangle(own.size, pose, view)
            if outline is None or min(outline[2:] - outline[:2]) < MIN_BOX_PX:
                continue
            left, top = np.floor(outline[:2]).astype(int).tolist()
            right, bottom = np.ceil(outline[2:]).astype(int).tolist()
            images = {
                model: draw_view(rasterizers[model], scene, view).rgb.astype(np.float64)
                for model, scene in models.items()
            }
            found = _scored(view, (left, top, right, bottom), images)
            if masks is not None:
                sighting = masks[name, frame]
                outlines = {m: _outline_iou(one, track_id, sighting) for m, one in models.items()}
                found = replace(found, mask_iou=outlines)
            if distance is not None:
                inside = (slice(top, bottom), slice(left, right))
                truth = view.image[inside] / 255
                apart = {model: distance(image[inside], truth) for model, image in images.items()}
                found = replace(found, lpips=apart)
            yield found


def _outline_iou(scene: StreetScene, track_id: str, sighting: Sighting) -> float:
    """Overlap of the drawn vehicle's outline with the mask, where the mask is believed."""
    actor, time_us = scene.actors[track_id], sighting.timestamp_us
    pose = pose_at(actor.trajectory, time_us)
    assert pose is not None
    place = scene.corrected_camera(sighting.camera_from_world, sighting.camera_name, time_us)
    drawn, believed = actor_mask(actor, sighting.camera, place, pose), sighting.trust > 0.5
    return mask_iou(drawn & believed, (sighting.mask > 0.5) & believed)


def _scored(
    view: TrainingView, rectangle: Rectangle, images: Mapping[str, NDArray[np.float64]]
) -> TrackView:
    truth = view.image.astype(np.float64) / 255
    left, top, right, bottom = rectangle
    inside = (slice(top, bottom), slice(left, right))
    outer = grown(rectangle, _MARGIN, view.camera.width, view.camera.height)
    window = (slice(outer[1], outer[3]), slice(outer[0], outer[2]))
    inner = tuple(
        slice(part.start - whole.start, part.stop - whole.start)
        for part, whole in zip(inside, window, strict=True)
    )
    similarity = {
        model: ssim_map(torch.from_numpy(image[window]), torch.from_numpy(truth[window]))
        for model, image in images.items()
    }
    gap = np.ones((outer[3] - outer[1], _GAP, 3))
    tiles = [truth[window]]
    for image in images.values():
        tiles += [gap, image[window]]
    return TrackView(
        camera=view.camera_name,
        frame=view.frame,
        timestamp_us=view.timestamp_us,
        rectangle=rectangle,
        psnr={m: capped_psnr(image[inside], truth[inside]) for m, image in images.items()},
        ssim={model: float(found[inner].mean()) for model, found in similarity.items()},
        picture=(np.concatenate(tiles, axis=1).clip(0, 1) * 255).round().astype(np.uint8),
    )
