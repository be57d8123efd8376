"""Rendering quality of whole scenes (RECAST, section 5, Q2): which images count, and their scores.

The rule that picks images looks at boxes and at what hides them in any of the streets, never at
what an arm draws in the box, so that all arms are judged on the same images. The paper says neither
how many images it takes nor which; the numbers here are settings of ours.

Features are what networks make of the images of an arm in a scene: arrays by name, in one file.

| array | shape | |
|---|---|---|
| `drawn` | (N,) bool | whether the image could be rendered; the rows of others are NaN |
| `frame_toy`, `crop_toy` | (N, 128) | `ToyFeatures` |
| `frame_inception`, `crop_inception` | (N, 2048) | |
| `frame_clip`, `frame_clip_padded`, `crop_clip` | (N, D) | unit length |
| `text_clip` | (7, D) | of the positive prompts, the negative ones and "vehicle" |
| `lpips` | (N,) | mean over the scene's reference crops |
| `vqa` | (N, 6) | scores of the positive prompts, then the negative ones |

Margins are between what prompts claim of a picture, and cosines are of crops (paper, table 2). The
prompts are the paper's. It does not say how scores of several prompts are joined: here each list is
averaged. Cosines are raw, without CLIP's logit scale.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt

from recast.actors.observation import score_frame
from recast.arrays import Array, Image
from recast.cameras import PinholeCamera
from recast.core import files
from recast.core.errors import InputError
from recast.core.records import Record, read_record
from recast.core.table_files import read_npz
from recast.geometry import boxes, se3
from recast.logs import DrivingLog
from recast.metrics.actor_scores import ScoredCutout
from recast.metrics.frechet import load_inception
from recast.metrics.oracle_scores import box_pixels
from recast.metrics.perceptual import ToyFeatures, load_lpips
from recast.pretrained import Clip, checked_scores, load_vqa_scorer, square_crop
from recast.reconstruction.scores import Rectangle

FRAMES_FILE, REFERENCES_FILE = "frames.json", "references.json"
_VERSION: Literal[1] = 1
_MEND = "remove the artefact that holds it, and run again"


@dataclass(frozen=True)
class FrameRule:
    """When an image counts.

    Attributes:
        every: steps between the images of a rollout.
        least_px: least length in pixels of the shorter side of the box's rectangle, at least half
            of which is in the image.
        nearest, furthest: metres from the camera to the centre of the box.
        least_visible: share of points of the box that nothing may hide.
    """

    every: int = 5
    least_px: float = 32.0
    nearest: float = 3.0
    furthest: float = 60.0
    least_visible: float = 0.5

    def validate(self) -> None:
        """Raise InputError naming the option at fault."""
        checks = (
            ("`every`", self.every >= 1, self.every, "1 or more"),
            ("`least_px`", self.least_px >= 4, self.least_px, "4 or more"),
        )
        for option, fits, value, range_of in checks:
            if not fits:
                raise InputError(option, "value", f"is {value}", f"give {range_of}")

    def rectangle(
        self, size: Array, camera_from_actor: Array, camera: PinholeCamera
    ) -> Rectangle | None:
        """The box's rectangle in whole pixels, clipped to the image; None if it does not count.

        Args:
            size: (3,) lengths of the logged box's sides, metres.
            camera_from_actor: (4, 4).
            camera: intrinsics of the image as it is rendered.
        """
        if not self.nearest <= np.linalg.norm(camera_from_actor[:3, 3]) <= self.furthest:
            return None
        found = box_pixels(size, camera_from_actor, camera)
        if found is None or min(found[2] - found[0], found[3] - found[1]) < self.least_px:
            return None
        return found


@dataclass(frozen=True)
class RolloutFrame:
    """An image of a rollout that counts.

    Attributes:
        motion, setting, step: motion and setting of the rollout, and the step in it.
        rectangle: left, top, right, bottom of the logged box at the simulated pose, pixels.
    """

    motion: str
    setting: str
    step: int
    camera: str
    rectangle: Rectangle


@dataclass(frozen=True)
class LoggedFrame:
    """A logged image that counts.

    Attributes:
        frame: number of the image in its stream.
        timestamp_us: log time.
        rectangle: left, top, right, bottom of the logged box at its logged pose, pixels.
        azimuth: radians, of the camera seen from the vehicle; 0 is ahead of it.
    """

    camera: str
    frame: int
    timestamp_us: int
    rectangle: Rectangle
    azimuth: float


def visible_share(
    depth: NDArray[np.float32], size: Array, camera_from_actor: Array, camera: PinholeCamera
) -> float:
    """Share of 5 x 5 x 5 points of a box that lie in the image and before what is drawn there.

    Args:
        depth: (H, W) metres along the camera's z axis of the street without the vehicle, inf for
            the sky.
        size: (3,) lengths of the box's sides, metres.
        camera_from_actor: (4, 4).
    """
    points = boxes.lattice(size, camera_from_actor)
    ahead = points[points[:, 2] > 0.1]
    pixels, z = camera.project(ahead)
    column, row = np.floor(pixels).astype(np.int64).T
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    before = z[inside] < depth[row[inside], column[inside]]
    return float(before.sum() / len(points))


def logged_frames(
    log: DrivingLog, track_id: str, cameras: Iterable[tuple[str, PinholeCamera]], rule: FrameRule
) -> Iterator[LoggedFrame]:
    """Logged images in which a vehicle's box counts and no other labelled box hides it.

    Args:
        cameras: names with intrinsics as images are rendered.
    """
    track = log.tracks[track_id]
    for name, camera in cameras:
        stream = log.cameras[name]
        for frame in range(len(stream.timestamps_us)):
            score = score_frame(log, track, stream, frame)
            if score is None or score.unoccluded < rule.least_visible:
                continue
            time = score.timestamp_us
            world_from_camera = log.world_from_rig.at(time) @ stream.rig_from_camera
            camera_from_actor = se3.inverse(world_from_camera) @ track.trajectory.at(time)
            rectangle = rule.rectangle(track.size, camera_from_actor, camera)
            if rectangle is not None:
                yield LoggedFrame(name, frame, time, rectangle, score.azimuth)


def spread_over_azimuth(frames: list[LoggedFrame], most: int) -> list[int]:
    """Indices of at most `most` frames whose views of the vehicle differ most, in order.

    Greedy: the first frame, then always the one whose azimuth is furthest from those chosen.
    """
    if len(frames) <= most:
        return list(range(len(frames)))
    angles = np.array([frame.azimuth for frame in frames])
    chosen = [0]
    apart = np.full(len(frames), np.inf)
    while len(chosen) < most:
        turn = np.abs((angles - angles[chosen[-1]] + np.pi) % (2 * np.pi) - np.pi)
        apart = np.minimum(apart, turn)
        apart[chosen] = -1.0
        chosen.append(int(np.argmax(apart)))
    return sorted(chosen)


class FramesRecord(Record):
    """frames.json.

    Attributes:
        frames: frames in the order of motions, steps and cameras.
        shown: indices of the frames that stand in the figure.
        failures: reason why a motion was not driven, by motion with its setting.
    """

    version: Literal[1] = _VERSION
    frames: tuple[RolloutFrame, ...]
    shown: tuple[NonNegativeInt, ...]
    failures: dict[str, str] = Field(default_factory=dict)


class ReferencesRecord(Record):
    """references.json.

    Attributes:
        frames: logged images that count.
        compared: indices of those whose crops LPIPS and the CLIP image score compare with.
    """

    version: Literal[1] = _VERSION
    frames: tuple[LoggedFrame, ...]
    compared: tuple[NonNegativeInt, ...]


def read_frames(folder: Path) -> FramesRecord:
    """Read frames.json; InputError if it is missing or damaged."""
    return read_record(folder / FRAMES_FILE, FramesRecord, _VERSION, _MEND)


def read_references(folder: Path) -> ReferencesRecord:
    """Read references.json; InputError if it is missing or damaged."""
    return read_record(folder / REFERENCES_FILE, ReferencesRecord, _VERSION, _MEND)


def shown_frames(frames: tuple[RolloutFrame, ...]) -> tuple[int, ...]:
    """For each motion and setting, the frame with the largest rectangle, the first of equals."""
    best: dict[tuple[str, str], int] = {}
    for index, frame in enumerate(frames):
        key = (frame.motion, frame.setting)
        if key not in best or _area(frame.rectangle) > _area(frames[best[key]].rectangle):
            best[key] = index
    return tuple(sorted(best.values()))


def _area(rectangle: Rectangle) -> int:
    left, top, right, bottom = rectangle
    return (right - left) * (bottom - top)


Features = Mapping[str, NDArray[np.generic]]
Measure = Callable[[Sequence[Image]], NDArray[np.generic]]
"""From images to an array with a row for each."""

BATCH = 16
"""Images a network sees at once: part of what the features are, down to the last bit."""
_GREY = np.full(3, 128, np.uint8)
FEATURES_FILE = "features.npz"
OF_TEXTS = ("text_clip",)
"""Arrays without a row an image."""
_LARGEST = 1 << 32  # bytes
_PREFIX = "A driving-camera image with"
POSITIVE = (
    f"{_PREFIX} realistic vehicles",
    f"{_PREFIX} complete and recognizable vehicles",
    f"{_PREFIX} vehicles that have normal shapes and intact geometry",
)
NEGATIVE = (
    f"{_PREFIX} unrealistic vehicles",
    f"{_PREFIX} incomplete or unrecognizable vehicles",
    f"{_PREFIX} vehicles that have distorted shapes or fragmented geometry",
)
VEHICLE = "vehicle"
SHOWN = 1000.0
"""Factor of both margins in tables."""


@dataclass(frozen=True)
class SeenImage:
    """An image and where the vehicle's box is in it.

    Attributes:
        image: (H, W, 3) uint8.
        rectangle: rectangle of the box, see `FrameRule.rectangle`.
        outline: (H, W) bool inside of the box's outline, for masked crops.
    """

    image: Image
    rectangle: Rectangle
    outline: NDArray[np.bool_] | None = None


class Networks:
    """What is computed of an image; the stand-in `toy` is always there.

    Args:
        inception, clip, lpips, vqa, device: see `NetworkFiles`.

    Raises:
        InputError: weights are missing or something else.
    """

    def __init__(
        self,
        inception: Path | None = None,
        clip: Path | None = None,
        lpips: Path | None = None,
        vqa: str | None = None,
        device: str = "cpu",
    ) -> None:
        self._of_frames: dict[str, Measure] = {"frame_toy": _toy}
        self._of_crops: dict[str, Measure] = {"crop_toy": _toy}
        self._texts: dict[str, NDArray[np.generic]] = {}
        self._colour = _GREY
        self._lpips = None if lpips is None else load_lpips(lpips).to(device)
        if inception is not None:
            network = load_inception(inception).to(device)
            self._of_frames["frame_inception"] = network.embeddings
            self._of_crops["crop_inception"] = network.embeddings
        if clip is not None:
            towers = Clip.read(clip, device)
            self._colour = towers.mean_colour
            self._texts["text_clip"] = towers.texts((*POSITIVE, *NEGATIVE, VEHICLE))
            self._of_frames["frame_clip"] = partial(towers.images, fit="published")
            self._of_frames["frame_clip_padded"] = partial(towers.images, fit="padded")
            self._of_crops["crop_clip"] = partial(towers.images, fit="whole")
        if vqa is not None:
            scorer = load_vqa_scorer(vqa, device)
            prompts = (*POSITIVE, *NEGATIVE)
            self._of_frames["vqa"] = lambda frames: checked_scores(
                scorer.score(frames, prompts), len(frames), len(prompts), scorer.name
            )

    def look(self, images: Iterable[SeenImage | None], compared: Sequence[SeenImage]) -> Features:
        """Features of images, see `recast.metrics.scene_level_images`.

        Args:
            images: images in order; None for one that could not be rendered.
            compared: the scene's reference images, for LPIPS; none gives NaN.
        """
        drawn: list[bool] = []
        kept: list[Image] = []  # crops, for LPIPS: the features of its references are costly
        parts: dict[str, list[NDArray[np.generic]]] = {
            name: [] for name in (*self._of_frames, *self._of_crops)
        }
        waiting = iter(images)
        while batch := list(islice(waiting, BATCH)):
            seen = [one for one in batch if one is not None]
            drawn += [one is not None for one in batch]
            if not seen:
                continue
            frames, crops = [one.image for one in seen], [self._crop(one) for one in seen]
            for given, measures in ((frames, self._of_frames), (crops, self._of_crops)):
                for name, measure in measures.items():
                    parts[name].append(measure(given))
            if self._lpips is not None:
                kept += crops
        if self._lpips is not None:
            parts["lpips"] = [self._distances(kept, [self._crop(one) for one in compared])]
        shown = np.array(drawn, np.bool_)
        return {
            "drawn": shown,
            **{name: _spread(rows, shown) for name, rows in parts.items()},
            **self._texts,
        }

    def _distances(self, crops: Sequence[Image], references: Sequence[Image]) -> Array:
        """(N,) mean LPIPS to the references; NaN where there is none."""
        assert self._lpips is not None
        if not references or not crops:
            return np.full(len(crops), np.nan)
        return self._lpips.distances(crops, references).mean(axis=1)

    def _crop(self, seen: SeenImage) -> Image:
        return square_crop(seen.image, seen.rectangle, self._colour, mask=seen.outline)


def _toy(images: Sequence[Image]) -> NDArray[np.generic]:
    """`ToyFeatures` of images of which nothing is transparent."""
    network = ToyFeatures()
    opaque = (ScoredCutout(one.astype(np.float64) / 255, np.ones(one.shape[:2])) for one in images)
    return np.stack([network.features(one) for one in opaque])


def _spread(rows: Sequence[NDArray[np.generic]], drawn: NDArray[np.bool_]) -> NDArray[np.generic]:
    """Rows of the drawn images in their places, NaN in the others."""
    if not rows:
        return np.full(len(drawn), np.nan)
    values = np.concatenate(rows)
    out = np.full((len(drawn), *values.shape[1:]), np.nan)
    out[drawn] = values
    return out


def save_features(features: Features, path: Path) -> None:
    """Write arrays, whole or not at all; the same arrays give the same bytes."""
    with files.atomic_file(path) as partial, partial.open("wb") as file:
        np.savez(file, allow_pickle=False, **features)


def load_features(path: Path) -> Features:
    """Read what `save_features` wrote.

    Raises:
        InputError: the file is missing or damaged, or an array has another number of rows.
    """
    found = read_npz(path, _MEND, limit=_LARGEST)
    drawn = found.get("drawn")
    if drawn is None or drawn.dtype != np.bool_ or drawn.ndim != 1:
        raise InputError(path, "drawn", "is missing or not boolean", _MEND)
    for name, array in found.items():
        if name not in OF_TEXTS and len(array) != len(drawn):
            raise InputError(path, name, f"has {len(array)} rows, expected {len(drawn)}", _MEND)
    return found


def clip_margin(frames: Array, positive: Array, negative: Array) -> Array:
    """(N,) mean cosine with the positive prompts less that with the negative ones.

    Args:
        frames: (N, D) embeddings of whole frames, of unit length as those below.
        positive, negative: (P, D) and (Q, D) embeddings of prompts.
    """
    return vqa_margin(frames @ positive.T, frames @ negative.T)


def vqa_margin(positive: Array, negative: Array) -> Array:
    """(N,) mean score of the positive prompts less that of the negative ones.

    Args:
        positive, negative: (N, P) and (N, Q) scores of whole frames, see
            `recast.pretrained.VqaScorer`.
    """
    return positive.mean(axis=1) - negative.mean(axis=1)


def clip_text_score(crops: Array, text: Array) -> Array:
    """(N,) 100 times the cosine of crops (N, D) with a text (D,), all of unit length."""
    return 100.0 * (crops @ text)


def clip_image_score(crops: Array, references: Array) -> tuple[Array, Array]:
    """Mean (N,) and maximum (N,) over references of 100 times the cosine.

    Args:
        crops: (N, D) embeddings of crops, of unit length.
        references: (R, D) embeddings of one scene's references, at least one.
    """
    cosines = 100.0 * (crops @ references.T)
    return cosines.mean(axis=1), cosines.max(axis=1)


@dataclass(frozen=True)
class ScoreColumn:
    """A column of the table.

    Attributes:
        digits: number of digits after the point.
        features: name of the features of a Frechet distance; None for a mean of image scores.
    """

    heading: str
    digits: int
    higher_is_better: bool
    features: str | None = None


COLUMNS: Mapping[str, ScoreColumn] = {
    "fd_scene": ScoreColumn("scene FD", 2, False, "frame_inception"),
    "fd_scene_toy": ScoreColumn("scene FD, toy", 4, False, "frame_toy"),
    "clip_margin": ScoreColumn("CLIP margin x1000", 2, True),
    "clip_margin_padded": ScoreColumn("CLIP margin x1000, padded", 2, True),
    "vqa_margin": ScoreColumn("VQA margin x1000", 2, True),
    "fd_crop": ScoreColumn("crop FD", 2, False, "crop_inception"),
    "fd_crop_toy": ScoreColumn("crop FD, toy", 4, False, "crop_toy"),
    "clip_img": ScoreColumn("CLIP image", 2, True),
    "clip_img_max": ScoreColumn("CLIP image, nearest", 2, True),
    "clip_veh": ScoreColumn("CLIP vehicle", 2, True),
    "lpips": ScoreColumn("LPIPS", 4, False),
}
"""In the order of the paper's table 2; `toy` is a stand-in where no weights are given."""

IMAGE_SCORES = tuple(name for name, column in COLUMNS.items() if column.features is None)


def image_scores(features: Features, references: Features, compared: Array) -> dict[str, Array]:
    """Scores (N,) of the images of an arm in a scene, by column; those there are networks for.

    Args:
        references: features of the scene's logged images.
        compared: (K,) indices of the references that crops are compared with.
    """
    found: dict[str, Array] = {}
    count = len(POSITIVE)
    if "text_clip" in features:
        texts = np.asarray(features["text_clip"], np.float64)
        positive, negative, vehicle = texts[:count], texts[count:-1], texts[-1]
        for name, key in (
            ("clip_margin", "frame_clip"),
            ("clip_margin_padded", "frame_clip_padded"),
        ):
            found[name] = SHOWN * clip_margin(_array(features, key), positive, negative)
        crops = _array(features, "crop_clip")
        found["clip_veh"] = clip_text_score(crops, vehicle)
        likened = _array(references, "crop_clip")[compared]
        found["clip_img"], found["clip_img_max"] = clip_image_score(crops, likened)
    if "vqa" in features:
        answers = _array(features, "vqa")
        assert answers.shape[1] == count + len(NEGATIVE)
        found["vqa_margin"] = SHOWN * vqa_margin(answers[:, :count], answers[:, count:])
    if "lpips" in features:
        found["lpips"] = _array(features, "lpips")
    return {name: found[name] for name in IMAGE_SCORES if name in found}


def _array(features: Features, name: str) -> Array:
    return np.asarray(features[name], np.float64)
