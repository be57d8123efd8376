"""The networks of the scene-level evaluation, looking at images in batches of fixed size."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array, Image
from recast.evaluation.actor_scores import Cutout
from recast.evaluation.features import ToyFeatures
from recast.evaluation.generation_inception import load_inception
from recast.evaluation.oracle_scores import Rectangle
from recast.evaluation.perceptual import load_lpips
from recast.evaluation.scene_level.scores import NEGATIVE, POSITIVE, VEHICLE, Features
from recast.pretrained import Clip, checked_scores, load_vqa_scorer, square_crop

Measure = Callable[[Sequence[Image]], NDArray[np.generic]]
"""From images to an array with a row for each."""

BATCH = 16
"""Images a network sees at once: part of what the features are, down to the last bit."""
_GREY = np.full(3, 128, np.uint8)


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
        """Features of images, see `recast.evaluation.scene_level.scores`.

        Args:
            images: in order; None for one that could not be rendered.
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
        mean: Array = self._lpips.distances(crops, references).mean(axis=1)
        return mean

    def _crop(self, seen: SeenImage) -> Image:
        return square_crop(seen.image, seen.rectangle, self._colour, mask=seen.outline)


def _toy(images: Sequence[Image]) -> NDArray[np.generic]:
    """`ToyFeatures` of images of which nothing is transparent."""
    network = ToyFeatures()
    opaque = (Cutout(one.astype(np.float64) / 255, np.ones(one.shape[:2])) for one in images)
    return np.stack([network.features(one) for one in opaque])


def _spread(rows: Sequence[NDArray[np.generic]], drawn: NDArray[np.bool_]) -> NDArray[np.generic]:
    """Rows of the drawn images in their places, NaN in the others."""
    if not rows:
        return np.full(len(drawn), np.nan)
    values = np.concatenate(rows)
    out = np.full((len(drawn), *values.shape[1:]), np.nan)
    out[drawn] = values
    return out
