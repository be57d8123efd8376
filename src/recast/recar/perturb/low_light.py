"""Low light: few photons, and a gain that brings up their noise."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np

from recast.recar.perturb.extent import find_object, shrinking
from recast.recar.perturb.kind import Kind, Picture, Positive, Positives, Share
from recast.recar.perturb.linear_light import to_display, to_linear
from recast.recar.perturb.premultiplied import Floats, colour_and_alpha, with_alpha


def sensor_noise(
    light: Floats, full_well: float, read_noise: float, rng: np.random.Generator
) -> Floats:
    """Shot noise (Poisson) and read noise (Gaussian) of a sensor, in the unit of `light`.

    Args:
        light: linear, 1 fills the well.
        full_well: electrons at 1.
        read_noise: standard deviation in electrons.
        rng: of the noise.
    """
    electrons = np.clip(light, 0, None).astype(np.float64) * full_well
    # Gaussian draws first: how many the Poisson ones take depends on the light.
    reading = read_noise * rng.standard_normal(light.shape)
    return ((rng.poisson(electrons) - electrons + reading) / full_well).astype(np.float32)


class LowLight(Kind):
    """Dusk and night: less light, shot and read noise in linear light, part of it gained back.

    Attributes:
        stops: halvings of the light at severity 1.
        recovered: share of these stops that the camera's gain brings back, noise and all.
        full_well: electrons of a white pixel by day.
        read_noise: electrons, standard deviation.
        pixels: lowest and highest extent in sensor pixels, drawn log-uniformly: noise is as
            coarse as on vehicles in logs, also where the picture is larger.
    """

    name: ClassVar[str] = "low-light"

    stops: Positive = 6.0
    recovered: Share = 0.55
    full_well: Positive = 8000.0
    read_noise: Positive = 3.0
    pixels: Positives = (80.0, 320.0)

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        height, width = rgba.shape[:2]
        sensor = float(np.exp(rng.uniform(*np.log(self.pixels))))
        scale = shrinking(find_object(rgba).extent, sensor, 1.0)
        colour, alpha = colour_and_alpha(rgba)
        exposure = 2.0 ** (-self.stops * severity)
        light = exposure * to_linear(colour)
        size = (max(round(width * scale), 1), max(round(height * scale), 1))
        small = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
        small_noise = sensor_noise(small, self.full_well, self.read_noise, rng)
        noise = cv2.resize(small_noise, (width, height), interpolation=cv2.INTER_LINEAR)
        gain = exposure**-self.recovered
        return with_alpha(to_display(gain * (light + noise)), alpha)
