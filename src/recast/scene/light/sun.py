"""Where the sun may stand, told by which surfaces of a street are bright and which are not.

With the sun in some direction, surfaces that face it unhindered are brighter and warmer than the
others. How well that explains the street says how likely the sun is there. A street hardly proves
one direction: light is worked out with all of them, each by its probability. The sky's own picture
does not help: cameras on cars see a band above the horizon, and the sun stands above that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from recast.arrays import Array
from recast.scene.light.surfaces import Occupancy, Patches
from recast.splats.sh import basis

AZIMUTHS, ELEVATIONS = 24, np.radians([20.0, 30.0, 40.0, 50.0, 60.0, 70.0])
DIRECTIONS = AZIMUTHS * len(ELEVATIONS)
SUN_OVER_SKY = 2.0
"""Light of the sun on what faces it over that of the sky on level ground, on a clear day."""
_BRIGHTNESS, _WARMTH = 1.0, 0.2  # weights of the cues
_GROUND, _WALLS = 50.0, 35.0
"""Independent measurements that ground and walls count for, however many patches they have."""
_PLENTY = 500  # patches; fewer count for less
_MOST, _FEWEST = 1000, 40  # patches of a kind
_UPRIGHT = 0.35  # a normal with less of "up" is that of a wall
_FLATTEST = 0.05  # deviation of the expected light below which a direction explains nothing
_GREY = 0.5  # logarithm of red over blue, from the median
_LIFT_M = 0.3
_VAGUE = 0.1  # certainty below which no direction is named
_BANDS = torch.tensor([torch.pi, *[2 * torch.pi / 3] * 3, *[torch.pi / 4] * 5], dtype=torch.float64)
"""Of the clamped cosine in harmonics; Ramamoorthi and Hanrahan (2001), "An efficient representation
for irradiance environment maps"."""


@dataclass(frozen=True)
class SunBelief:
    """What a street says of the sun.

    Attributes:
        probability: (D,) probability of each of the `directions`; adds up to one.
    """

    probability: Array

    @property
    def certainty(self) -> float:
        """0 to 1: length of the mean level direction, each direction as a unit vector."""
        level = directions()[0][:, :2]
        level = level / np.linalg.norm(level, axis=1, keepdims=True)
        return float(np.linalg.norm(self.probability @ level))

    @property
    def harmonics(self) -> Array:
        """(9,) coefficients of the expected cosine to the sun, 0 where it is behind, by normal."""
        values = basis(torch.from_numpy(directions()[0]), 2).numpy()
        return _BANDS.numpy() * (self.probability @ values)

    def given(self, evidence: Array) -> SunBelief:
        """The belief with more evidence.

        Args:
            evidence: (D,) logarithms of likelihoods, up to a constant.
        """
        probability = self.probability * np.exp(evidence - evidence.max())
        return SunBelief(probability / probability.sum())

    def explain(self) -> str:
        """One line for people."""
        if self.certainty < _VAGUE:
            return "the sun's direction is unknown: light depends on the place, not on the heading"
        x, y, _ = self.probability @ directions()[0]
        return (
            f"sun towards azimuth {np.degrees(np.arctan2(y, x)):.0f} degrees (0 is world x), "
            f"certainty {self.certainty:.2f}"
        )


def directions() -> tuple[Array, Array]:
    """Directions (D, 3) for the sun, all azimuths for each elevation, and their shares (D,)."""
    azimuth = np.arange(AZIMUTHS) * 2 * np.pi / AZIMUTHS
    e, a = (grid.ravel() for grid in np.meshgrid(ELEVATIONS, azimuth, indexing="ij"))
    towards = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    return towards, np.cos(e) / np.cos(e).sum()


def find_sun(patches: Patches, occupancy: Occupancy) -> SunBelief:
    """How likely the sun stands in each direction."""
    towards, prior = directions()
    patches = patches.select(patches.lifeless)
    upright = np.abs(patches.normals[:, 2]) < _UPRIGHT
    evidence = np.zeros(len(towards))
    for chosen, trust in ((patches.level, _GROUND), (upright, _WALLS)):
        rows = np.flatnonzero(chosen)
        group = patches.select(rows[:: max(-(-len(rows) // _MOST), 1)])
        if len(group) < _FEWEST:
            continue
        trust *= min(len(group) / _PLENTY, 1.0)
        bright, warmth = np.log(group.brightness), group.warmth
        grey = np.abs(warmth - np.median(warmth)) < _GREY
        for index, direction in enumerate(towards):
            light = _expected(group, occupancy, direction)
            explained = _BRIGHTNESS * _explained(light, bright)
            explained += _WARMTH * _explained(light[grey], warmth[grey])
            evidence[index] += trust * explained
    return SunBelief(prior).given(evidence)


def _expected(patches: Patches, occupancy: Occupancy, towards: Array) -> Array:
    """Logarithm (P,) of the light with the sun there over that without one."""
    facing = np.maximum(patches.normals @ towards, 0)
    lit = np.flatnonzero(facing > 0)
    seen = np.zeros(len(patches))
    seen[lit] = occupancy.through(patches.points[lit] + _LIFT_M * patches.normals[lit], towards)
    sky = 0.5 + 0.5 * patches.normals[:, 2]
    return np.log1p(SUN_OVER_SKY * facing * seen / np.maximum(sky, 0.1))


def _explained(light: Array, values: Array) -> float:
    """Gain in log-likelihood for each measurement: -log(1 - r^2) / 2, for r > 0."""
    if len(light) < _FEWEST or light.std() < _FLATTEST or values.std() == 0:
        return 0.0
    r = max(float(np.corrcoef(light, values)[0, 1]), 0.0)
    return -0.5 * float(np.log(max(1 - r * r, 1e-6)))
