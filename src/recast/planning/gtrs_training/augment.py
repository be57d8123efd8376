"""Changes of a picture that leave what it shows: rendered scenes look worse than traced ones."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.planning.gtrs_training.store import CLUES

Image = NDArray[np.uint8]

_CLEAN = 0.15
_MIRRORED_CLUES = np.array([-1.0 if name not in ("present", "x", "cos") else 1.0 for name in CLUES])


def augment(image: Image, rng: np.random.Generator) -> Image:
    """Colour, exposure, blur, speckle, floaters, noise, JPEG and a shift of some pixels.

    As of reconstructed scenes: blurred patches, blobs of wrong colour in thin air, haze; as of
    cameras: exposure, white balance, noise. One in seven stays as it is.

    Args:
        image: (H, W, 3) uint8.
    """
    if rng.uniform() < _CLEAN:
        return image
    picture = image
    if rng.uniform() < 0.5:
        picture = _shifted(picture, int(rng.integers(-3, 4)), int(rng.integers(-2, 3)))
    if rng.uniform() < 0.5:
        picture = _blurred(picture, float(rng.uniform(0.4, 1.5)))
    if rng.uniform() < 0.35:
        picture = _blurred_patches(picture, rng)
    if rng.uniform() < 0.3:
        picture = _floaters(picture, rng)
    found = np.asarray(cv2.transform(picture.astype(np.float32), _colours(rng)), np.float32)
    if rng.uniform() < 0.5:
        noise = rng.standard_normal(picture.shape, np.float32)
        found += np.float32(rng.uniform(1.0, 8.0)) * noise
    picture = np.clip(found, 0, 255).astype(np.uint8)
    if rng.uniform() < 0.3:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(35, 90))]
        _, coded = cv2.imencode(".jpg", picture, quality)
        picture = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)
    return np.ascontiguousarray(picture)


def mirror_image(image: Image) -> Image:
    """The stitched picture (H, W, 3) of the mirrored street: right becomes left, cameras too."""
    return np.ascontiguousarray(image[:, ::-1])


def mirror_clues(clues: NDArray[np.float32]) -> NDArray[np.float32]:
    """Clues (..., 10) of the mirrored street."""
    return (clues * _MIRRORED_CLUES).astype(np.float32)


def mirror_status(status: NDArray[np.float32]) -> NDArray[np.float32]:
    """Status (..., 8) of the mirrored street: left and right change places, vy and ay sign."""
    found = status[..., [2, 1, 0, 3, 4, 5, 6, 7]].copy()
    found[..., [5, 7]] *= -1.0
    return found


def _shifted(picture: Image, across: int, down: int) -> Image:
    """Moved by some pixels; the edge fills what comes in."""
    height, width = picture.shape[:2]
    rows = np.clip(np.arange(height) - down, 0, height - 1)
    columns = np.clip(np.arange(width) - across, 0, width - 1)
    return picture[rows][:, columns]


def _blurred(picture: Image, sigma: float) -> Image:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma), np.uint8)


def _colours(rng: np.random.Generator) -> NDArray[np.float64]:
    """(3, 4): saturation, white balance, exposure, contrast around a middle grey, brightness."""
    saturation, contrast = rng.uniform(0.6, 1.3), rng.uniform(0.8, 1.2)
    gain = rng.uniform(0.75, 1.25) * rng.uniform(0.93, 1.07, 3)
    mixed = saturation * np.eye(3) + (1.0 - saturation) / 3
    brightness = 110.0 * (1.0 - contrast) + rng.uniform(-12.0, 12.0)
    return np.concatenate([contrast * gain[:, None] * mixed, np.full((3, 1), brightness)], axis=1)


def _blurred_patches(picture: Image, rng: np.random.Generator) -> Image:
    height, width = picture.shape[:2]
    soft = _blurred(picture, float(rng.uniform(2.0, 4.0)))
    mask = np.zeros((height, width), np.uint8)
    for _ in range(int(rng.integers(1, 5))):
        centre = int(rng.integers(width)), int(rng.integers(height))
        axes = int(rng.integers(8, 60)), int(rng.integers(5, 25))
        cv2.ellipse(mask, centre, axes, 0.0, 0.0, 360.0, 255, -1)
    return np.where(mask[..., None] > 0, soft, picture)


def _floaters(picture: Image, rng: np.random.Generator) -> Image:
    """Small translucent blobs, smaller than any vehicle that matters."""
    height, width = picture.shape[:2]
    drawn = picture.copy()
    for _ in range(int(rng.integers(1, 10))):
        centre = int(rng.integers(width)), int(rng.integers(height))
        axes = int(rng.integers(1, 10)), int(rng.integers(1, 5))
        colour = rng.integers(0, 256, 3).tolist()
        cv2.ellipse(drawn, centre, axes, float(rng.uniform(0, 180)), 0.0, 360.0, colour, -1)
    weight = float(rng.uniform(0.3, 0.9))
    return np.asarray(cv2.addWeighted(drawn, weight, picture, 1.0 - weight, 0.0), np.uint8)
