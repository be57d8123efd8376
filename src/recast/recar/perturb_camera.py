"""Faults of air, lens, sensor and recorder: fog, blur, low light, few pixels, compression."""

from __future__ import annotations

import io
from typing import Annotated, ClassVar

import cv2
import numpy as np
from PIL import Image as PilImage
from pydantic import Field

from recast.arrays import Image
from recast.geometry.colour import linear_to_srgb, srgb_to_linear
from recast.recar.perturb_kind import (
    Floats,
    ObjectBox,
    PerturbationKind,
    Positive,
    Positives,
    Share,
    Shares,
    Weight,
    backdrop,
    colour_and_alpha,
    premultiplied,
    segmented,
    shrinking,
    straight,
    with_alpha,
)

_ENLARGERS = (cv2.INTER_LINEAR, cv2.INTER_CUBIC, cv2.INTER_LANCZOS4)
CONTRAST = 3.912
"""-ln 0.02: visibility is where two hundredths of the contrast are left (Koschmieder, 1924)."""
_BLOCK = 16  # pixels of a coding unit where colour is halved in both directions


def convolve(rgba: Image, kernel: Floats, width: float) -> Image:
    """Blur (H, W, 4) uint8 in linear light; the mask is then cut as a segmenter would.

    The kernel (k, k), k odd, sums to 1; `width` is that of an edge after the blur, in pixels.
    """
    colour, alpha = colour_and_alpha(rgba)
    light = np.dstack([srgb_to_linear(colour) * alpha[..., None], alpha])
    # Nothing is known beyond the picture: the object goes on there as at its border.
    blurred = cv2.filter2D(light, cv2.CV_32F, kernel, borderType=cv2.BORDER_REPLICATE)
    seen = np.clip(np.asarray(blurred[..., 3], np.float32), 0, 1)
    display = linear_to_srgb(blurred[..., :3] / np.maximum(seen, 1e-6)[..., None])
    return with_alpha(display, segmented(seen, width))


def disc_kernel(radius: float) -> Floats:
    """Uniform disc (the circle of confusion) of a radius in pixels, edges in shares of pixels."""
    reach = int(np.ceil(radius))
    offset = np.arange(-reach, reach + 1, dtype=np.float32)
    distance = np.hypot(offset[:, None], offset[None, :])
    disc = np.clip(radius + 0.5 - distance, 0, 1)
    return (disc / disc.sum()).astype(np.float32)


class Defocus(PerturbationKind):
    """A lens out of focus, or with a drop of water on it.

    Attributes:
        radius: radius of the disc at severity 1, over the extent.
    """

    name: ClassVar[str] = "defocus"

    weight: Weight = 0.5
    radius: Positive = 0.025

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        radius = severity * self.radius * box.extent
        return convolve(rgba, disc_kernel(radius), 1.5 * radius)


def line_kernel(length: float, angle: float) -> Floats:
    """Uniform line of `length` pixels through the centre, `angle` radians from the x axis."""
    reach = int(np.ceil(length / 2))
    offset = np.arange(-reach, reach + 1)
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    # Points along the line, each shared among the four pixels around it.
    for step in (np.arange(8 * reach + 1) + 0.5) / (8 * reach + 1) - 0.5:
        x, y = step * length * np.cos(angle), step * length * np.sin(angle)
        across = np.clip(1 - np.abs(offset - x), 0, 1)
        down = np.clip(1 - np.abs(offset - y), 0, 1)
        kernel += np.outer(down, across).astype(np.float32)
    return kernel / kernel.sum()


class MotionBlur(PerturbationKind):
    """Motion within the exposure: mostly across the picture, as vehicles pass one another.

    A vehicle of 4.5 m that passes at 20 m/s during 1/60 s moves by 7 % of its length.

    Attributes:
        length: length of the line at severity 1, over the extent.
        slope_deg: standard deviation of the line's slope, degrees.
    """

    name: ClassVar[str] = "motion-blur"

    weight: Weight = 0.5
    length: Positive = 0.08
    slope_deg: Positive = 12.0

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        angle = np.radians(self.slope_deg) * rng.standard_normal()
        length = severity * self.length * box.extent
        return convolve(rgba, line_kernel(length, angle), length)


def resample(rgba: Image, scale: float, enlarger: int) -> Image:
    """Shrink (H, W, 4) uint8 to `scale` in (0, 1] by area averages, and enlarge again.

    `enlarger` is OpenCV's interpolation on the way up.
    """
    height, width = rgba.shape[:2]
    small_size = (max(round(width * scale), 1), max(round(height * scale), 1))
    if small_size == (width, height):
        return rgba.copy()
    small = cv2.resize(premultiplied(rgba), small_size, interpolation=cv2.INTER_AREA)
    large = cv2.resize(small, (width, height), interpolation=enlarger)
    return straight(np.clip(large, 0, 1))


class Resampling(PerturbationKind):
    """Detail lost to few pixels, then enlarged by a drawn filter (linear, cubic or Lanczos).

    Attributes:
        smallest: extent in pixels at severity 1; the extent falls geometrically down to it.
    """

    name: ClassVar[str] = "resampling"

    smallest: Positive = 32.0

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        enlarger = _ENLARGERS[int(rng.integers(len(_ENLARGERS)))]
        scale = shrinking(box.extent, self.smallest, severity)
        return resample(rgba, scale, enlarger)


def sensor_noise(
    light: Floats, full_well: float, read_noise: float, rng: np.random.Generator
) -> Floats:
    """Shot noise (Poisson) and read noise (Gaussian) of a sensor, in the unit of `light`.

    Linear light of 1 is `full_well` electrons; `read_noise` is a standard deviation in electrons.
    """
    electrons = np.clip(light, 0, None).astype(np.float64) * full_well
    # Gaussian draws first: how many the Poisson ones take depends on the light.
    reading = read_noise * rng.standard_normal(light.shape)
    return ((rng.poisson(electrons) - electrons + reading) / full_well).astype(np.float32)


class LowLight(PerturbationKind):
    """Dusk and night: less light, shot and read noise in linear light, part of it gained back.

    Attributes:
        stops: halvings of the light at severity 1.
        recovered: share of these stops that the camera's gain brings back, noise and all.
        full_well: electrons of a white pixel by day.
        read_noise: standard deviation in electrons.
        pixels: lowest and highest extent in sensor pixels, drawn log-uniformly: noise is as
            coarse as on vehicles in logs, also where the picture is larger.
    """

    name: ClassVar[str] = "low-light"

    stops: Positive = 6.0
    recovered: Share = 0.55
    full_well: Positive = 8000.0
    read_noise: Positive = 3.0
    pixels: Positives = (80.0, 320.0)

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        height, width = rgba.shape[:2]
        sensor = float(np.exp(rng.uniform(*np.log(self.pixels))))
        scale = shrinking(box.extent, sensor, 1.0)
        colour, alpha = colour_and_alpha(rgba)
        exposure = 2.0 ** (-self.stops * severity)
        light = exposure * srgb_to_linear(colour)
        size = (max(round(width * scale), 1), max(round(height * scale), 1))
        small = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
        small_noise = sensor_noise(small, self.full_well, self.read_noise, rng)
        noise = cv2.resize(small_noise, (width, height), interpolation=cv2.INTER_LINEAR)
        gain = exposure**-self.recovered
        return with_alpha(linear_to_srgb(gain * (light + noise)), alpha)


def koschmieder(light: Floats, transmission: float, airlight: Floats) -> Floats:
    """I = J t + A (1 - t) in linear light, t = exp(-beta d), one depth for the whole object.

    J is `light` (H, W, 3) without fog, t `transmission` in [0, 1], A `airlight` (3,).
    """
    return light * np.float32(transmission) + airlight * np.float32(1 - transmission)


class Fog(PerturbationKind):
    """Fog or haze, and the veil of a dirty windscreen.

    Attributes:
        visibility_m: visibility at severity 1; the density beta = 3.912 / visibility grows with
            severity.
        distance_m: distances of the nearest and farthest vehicle, drawn uniformly.
        airlight: darkest and lightest grey of the fog, sRGB.
    """

    name: ClassVar[str] = "fog"

    visibility_m: Positive = 150.0
    distance_m: Positives = (10.0, 40.0)
    airlight: Shares = (0.55, 0.9)

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        distance = rng.uniform(*self.distance_m)
        grey = rng.uniform(*self.airlight) * rng.uniform(0.96, 1.04, 3)
        transmission = float(np.exp(-severity * CONTRAST / self.visibility_m * distance))
        colour, alpha = colour_and_alpha(rgba)
        airlight = srgb_to_linear(np.clip(grey, 0, 1).astype(np.float32))
        fogged = koschmieder(srgb_to_linear(colour), transmission, airlight)
        return with_alpha(linear_to_srgb(fogged), alpha)


def through_jpeg(colour: Image, quality: int, corner: tuple[int, int]) -> Image:
    """Write and read (H, W, 3) uint8 as baseline JPEG with halved colour (4:2:0).

    `quality` is as Pillow counts it, 1 to 95; `corner` is the row and column of this picture
    within a coding unit of the whole one.
    """
    row, column = corner
    padded = np.pad(colour, ((row, 0), (column, 0), (0, 0)), mode="edge")
    stream = io.BytesIO()
    PilImage.fromarray(padded).save(stream, "JPEG", quality=quality, subsampling=2)
    return np.array(PilImage.open(stream))[row:, column:]


def quality_between(best: int, worst: int, severity: float) -> int:
    """Quality whose quantiser steps lie geometrically between those of two qualities.

    The Independent JPEG Group's rule: steps grow by 2 - Q / 50 from quality 50 up, by 50 / Q below.
    """
    steps = [2 - quality / 50 if quality >= 50 else 50 / quality for quality in (best, worst)]
    step = steps[0] ** (1 - severity) * steps[1] ** severity
    return round(50 * (2 - step) if step <= 1 else 50 / step)


class Compression(PerturbationKind):
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

    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        height, width = rgba.shape[:2]
        street = backdrop(rgba, box, rng)
        smallest = float(np.exp(rng.uniform(*np.log(self.pixels))))
        row, column = rng.integers(_BLOCK, size=2)
        scale = shrinking(box.extent, smallest, severity)
        colour, alpha = colour_and_alpha(rgba)
        seen = np.where(alpha[..., None] > 0, colour, street)
        size = (max(round(width * scale), 1), max(round(height * scale), 1))
        small = np.asarray(cv2.resize(seen, size, interpolation=cv2.INTER_AREA), np.float32)
        quality = quality_between(self.best, self.worst, severity)
        levels = np.round(255 * np.clip(small, 0, 1)).astype(np.uint8)
        decoded = through_jpeg(levels, quality, (int(row), int(column)))
        large = cv2.resize(decoded, (width, height), interpolation=cv2.INTER_CUBIC)
        return with_alpha(large.astype(np.float32) / 255, alpha)
