"""Compression: JPEG as recorders store their pictures."""

from __future__ import annotations

import io
from typing import Annotated, ClassVar

import cv2
import numpy as np
from PIL import Image
from pydantic import Field

from recast.recar.perturb.backdrop import backdrop
from recast.recar.perturb.extent import find_object, shrinking
from recast.recar.perturb.kind import Kind, Picture, Positives
from recast.recar.perturb.premultiplied import Floats, colour_and_alpha, with_alpha

_BLOCK = 16  # pixels of a coding unit where colour is halved in both directions


def through_jpeg(colour: Picture, quality: int, corner: tuple[int, int]) -> Picture:
    """Write and read (H, W, 3) uint8 as baseline JPEG with halved colour (4:2:0).

    Args:
        colour: display colours.
        quality: Pillow's, 1 to 95.
        corner: row and column of this picture within a coding unit of the whole one.
    """
    row, column = corner
    padded = np.pad(colour, ((row, 0), (column, 0), (0, 0)), mode="edge")
    stream = io.BytesIO()
    Image.fromarray(padded).save(stream, "JPEG", quality=quality, subsampling=2)
    return np.array(Image.open(stream))[row:, column:]


def quality_between(best: int, worst: int, severity: float) -> int:
    """Quality whose quantiser steps lie geometrically between those of two qualities.

    The Independent JPEG Group's rule: steps grow by 2 - Q / 50 from quality 50 up, by 50 / Q below.
    """
    steps = [2 - quality / 50 if quality >= 50 else 50 / quality for quality in (best, worst)]
    step = steps[0] ** (1 - severity) * steps[1] ** severity
    return round(50 * (2 - step) if step <= 1 else 50 / step)


class Compression(Kind):
    """JPEG blocks, ringing and bled colours, at the size that vehicles have in logs.

    The picture is compressed with a street behind the object, as it was in the log, after the
    object is brought down towards a drawn extent: in a photograph of a thousand pixels the blocks
    would be far too small.

    Attributes:
        best, worst: quality at severity 0 and 1, as Pillow counts it.
        pixels: shortest and longest extent at severity 1, drawn log-uniformly.
    """

    name: ClassVar[str] = "compression"

    best: Annotated[int, Field(ge=1, le=95)] = 95
    worst: Annotated[int, Field(ge=1, le=95)] = 15
    pixels: Positives = (100.0, 320.0)

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        height, width = rgba.shape[:2]
        box = find_object(rgba)
        street = backdrop(rgba, box, rng)
        smallest = float(np.exp(rng.uniform(*np.log(self.pixels))))
        row, column = rng.integers(_BLOCK, size=2)
        scale = shrinking(box.extent, smallest, severity)
        colour, alpha = colour_and_alpha(rgba)
        seen = np.where(alpha[..., None] > 0, colour, street)
        size = (max(round(width * scale), 1), max(round(height * scale), 1))
        small = np.asarray(cv2.resize(seen, size, interpolation=cv2.INTER_AREA), np.float32)
        quality = quality_between(self.best, self.worst, severity)
        decoded = through_jpeg(_to_bytes(small), quality, (int(row), int(column)))
        large = cv2.resize(decoded, (width, height), interpolation=cv2.INTER_CUBIC)
        return with_alpha(large.astype(np.float32) / 255, alpha)


def _to_bytes(unit: Floats) -> Picture:
    return np.round(255 * np.clip(unit, 0, 1)).astype(np.uint8)
