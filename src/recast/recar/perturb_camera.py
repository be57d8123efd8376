"""What all kinds of perturbation share, and the faults of air, lens, sensor and recorder.

Colour beside an object's edge means nothing where alpha is zero, so whatever mixes neighbouring
pixels works on colour times alpha.
"""

from __future__ import annotations

import io
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage
from pydantic import AfterValidator, Field

from recast.arrays import Image
from recast.core.records import Record
from recast.geometry.colour import linear_to_srgb, srgb_to_linear
from recast.trellis.conditioning import OPAQUE, object_box

Floats = NDArray[np.floating[Any]]


def _in_order(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] > interval[1]:
        raise ValueError(f"the first value {interval[0]:g} is above the second {interval[1]:g}")
    return interval


Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Shares = Annotated[tuple[Share, Share], AfterValidator(_in_order)]
Positives = Annotated[tuple[Positive, Positive], AfterValidator(_in_order)]


class PerturbationKind(Record, ABC):
    """One kind with its figures, as the configuration holds it.

    Lengths are shares of the object's extent (the longer side of its box), because the model sees
    the object scaled to one size, whatever its size in the log.

    Attributes:
        weight: how often it is drawn, relative to the others; 0 switches it off.
        severity: lowest and highest severity that is drawn, uniformly.
    """

    name: ClassVar[str]

    weight: Weight = 1.0
    severity: Shares = (0.1, 1.0)

    def __call__(self, rgba: Image, severity: float, rng: np.random.Generator) -> Image:
        """Spoil a picture.

        Args:
            rgba: (H, W, 4) uint8, straight alpha; passes `recast.trellis.check_crop`.
            severity: severity in [0, 1]; 0 changes next to nothing, 1 as much as the kind's figures
                say.
            rng: generator of all that is random; what is drawn does not depend on the severity, so
                equal generators give the same fault, weaker or stronger.

        Returns:
            (H, W, 4) uint8, straight alpha; a new array.
        """
        return self._run(rgba, find_object(rgba), severity, rng)

    @abstractmethod
    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        """`__call__`, on the object's box."""


@dataclass(frozen=True)
class ObjectBox:
    """The object's box in its picture, in pixels: where alpha > 0.8; `left` column, `top` row."""

    left: int
    top: int
    width: int
    height: int

    @property
    def extent(self) -> int:
        """The longer side, pixels."""
        return max(self.width, self.height)

    @property
    def bottom(self) -> int:
        """The first row below the box."""
        return self.top + self.height

    @property
    def right(self) -> int:
        """The first column beyond the box."""
        return self.left + self.width


def find_object(rgba: Image) -> ObjectBox:
    """The box of a picture that passes `recast.trellis.check_crop`."""
    left, top, right, bottom = object_box(rgba[..., 3])
    return ObjectBox(left, top, right - left + 1, bottom - top + 1)


def shrinking(extent: float, smallest: float, severity: float) -> float:
    """Scale factor in (0, 1] that brings an object to `smallest` pixels at severity 1.

    Geometric in between: equal steps of severity lose equal shares. An object that is smaller
    already keeps its size.
    """
    return float(np.minimum(1.0, smallest / extent) ** severity)


def premultiplied(rgba: Image) -> Floats:
    """(H, W, 4) float32 in [0, 1]: colour times alpha, and alpha."""
    unit = np.asarray(rgba, np.float32) / 255
    unit[..., :3] *= unit[..., 3:]
    return unit


def straight(mixed: Floats) -> Image:
    """(H, W, 4) uint8 with straight alpha of premultiplied values; black where alpha is zero."""
    alpha = np.clip(mixed[..., 3], 0, 1)
    return with_alpha(mixed[..., :3] / np.maximum(alpha, 1e-6)[..., None], alpha)


def with_alpha(colour: Floats, alpha: Floats) -> Image:
    """(H, W, 4) uint8 of straight colours (H, W, 3) and alpha (H, W), both in [0, 1]."""
    levels = np.round(255 * np.clip(alpha, 0, 1)).astype(np.uint8)
    rgb = np.round(255 * np.clip(colour, 0, 1)).astype(np.uint8)
    rgb[levels == 0] = 0
    return np.dstack([rgb, levels])


def colour_and_alpha(rgba: Image) -> tuple[Floats, Floats]:
    """Straight colours (H, W, 3), black where alpha is zero, and alpha (H, W); in [0, 1]."""
    unit = np.asarray(rgba, np.float32) / 255
    unit[rgba[..., 3] == 0] = 0
    return unit[..., :3], unit[..., 3]


def value_noise(
    height: int, width: int, cell: float, rng: np.random.Generator, octaves: int = 3
) -> Floats:
    """Random field (height, width) float32 with mean about 0 and standard deviation about 1.

    Its largest lumps are `cell` pixels wide; each octave has lumps of half the size and strength.
    """
    total, power = np.zeros((height, width), np.float32), 0.0
    for octave in range(octaves):
        size = max(cell / 2**octave, 1.0)
        rows, columns = int(height / size) + 2, int(width / size) + 2
        grid = rng.standard_normal((rows, columns), np.float32)
        # Two knots beyond the field at most, so lumps keep their size at its borders.
        large = cv2.resize(
            grid, (round(columns * size) + 1, round(rows * size) + 1), interpolation=cv2.INTER_CUBIC
        )
        total += 0.5**octave * large[:height, :width]
        power += 0.25**octave
    return total / np.float32(0.75 * np.sqrt(power))


def signed_distance(alpha: Floats) -> Floats:
    """Pixels (H, W) to the nearest pixel across the edge of alpha > 0.5, less a half.

    So it is 0.5 in the first pixel inside and -0.5 in the first one outside.
    """
    inside = (alpha > 0.5).astype(np.uint8)
    within = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    beyond = cv2.distanceTransform(1 - inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.where(inside > 0, within - 0.5, 0.5 - beyond).astype(np.float32)


def reveal(rgba: Image, alpha: Floats, behind: Floats) -> Image:
    """Give a picture (H, W, 4) another mask `alpha` (H, W) in [0, 1].

    Where that is larger, the display colours `behind` (H, W, 3) in [0, 1] are seen through it.
    """
    colour, before = colour_and_alpha(rgba)
    added = np.maximum(alpha - before, 0) / np.maximum(alpha, 1e-6)
    return with_alpha(colour + (behind - colour) * added[..., None], alpha)


_BEHIND = np.array(
    [
        (0.62, 0.55, 0.46),  # plaster
        (0.42, 0.30, 0.25),  # brick
        (0.52, 0.52, 0.52),  # concrete
        (0.18, 0.23, 0.13),  # hedge
        (0.12, 0.15, 0.11),  # trees in the shade
        (0.66, 0.74, 0.84),  # sky
        (0.28, 0.28, 0.31),  # another vehicle, a dark window
    ],
    np.float32,
)


_DAYLIGHT = 0.6  # the brightest parts of a dark car by day, in display colours


def backdrop(rgba: Image, box: ObjectBox, rng: np.random.Generator) -> Floats:
    """A road, and what stands beyond it: (H, W, 3) float32 display colours in [0, 1].

    The horizon runs through the upper part of the object, as a car's camera sees other cars. The
    light is that of the object: where even its brightest parts are dark, the backdrop is dark.
    """
    height, width = rgba.shape[:2]
    extent = box.extent
    rows = np.arange(height, dtype=np.float32)[:, None]
    columns = np.arange(width, dtype=np.float32)[None, :]
    fine = value_noise(height, width, 0.06 * extent, rng)
    coarse = value_noise(height, width, 0.3 * extent, rng)

    grey = rng.uniform(0.22, 0.5) * np.array([1.0, 0.99, rng.uniform(0.92, 1.05)], np.float32)
    road = grey * (1 + 0.05 * fine + 0.08 * coarse)[..., None]

    standing = np.sort(rng.uniform(box.left - extent / 2, box.right + extent / 2, 4))
    colours = _BEHIND[rng.integers(len(_BEHIND), size=5)] * rng.uniform(0.6, 1.25, (5, 1))
    beyond = colours.astype(np.float32)[np.searchsorted(standing, columns[0])][None]
    beyond = beyond * (1 + 0.12 * fine + 0.12 * coarse)[..., None]

    horizon = box.top + rng.uniform(0.0, 0.55) * box.height + 0.02 * extent * coarse
    brightest = float(np.quantile(rgba[rgba[..., 3] > OPAQUE][:, :3], 0.97)) / 255
    light = rng.uniform(0.7, 1.15) * min(1.0, brightest / _DAYLIGHT)
    street = np.where((rows > horizon)[..., None], road, beyond) * light
    return np.clip(street, 0, 1).astype(np.float32)


def segmented(alpha: Floats, width: float) -> Floats:
    """Sharpen a blurred coverage (H, W) about one half, as segmenters cut sharply through any blur.

    `width` is that of the blurred edge in pixels; up to 1 the mask stays as it is.
    """
    return np.clip((alpha - 0.5) * max(width, 1.0) + 0.5, 0, 1)


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
