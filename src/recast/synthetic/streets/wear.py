"""What years do to asphalt: wheel tracks, patches, sealed cracks, covers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.random import Generator
from numpy.typing import NDArray

from recast.logs import Lane
from recast.synthetic.streets.road import Road
from recast.synthetic.streets.triangles import Decals

Array = NDArray[np.float64]

_TRACKS, _PATCHES, _SEALS, _COVERS = 0.001, 0.0018, 0.0026, 0.0034
_SOFT = ((0.48, 0.93), (0.34, 0.87), (0.18, 0.83))
"""Half-widths of a wheel track in metres, and its brightness inside each."""


@dataclass(frozen=True)
class Wear:
    """How worn a road is.

    Attributes:
        colour: linear RGB of the asphalt.
        patches, cracks, covers: a hundred metres of lane.
        tracks: 1 shows plain wheel tracks, 0 none.
    """

    colour: tuple[float, float, float] = (0.115, 0.115, 0.118)
    patches: float = 3.0
    cracks: float = 9.0
    covers: float = 2.5
    tracks: float = 1.0


def wear_road(decals: Decals, road: Road, wear: Wear, rng: Generator) -> None:
    """Wear the lanes of a road down."""
    base = np.array(wear.colour)
    indices = [*range(1, road.section.forward + 1), *range(-road.section.backward, 0)]
    for index in indices:
        inner, outer = road.section.lane(index)
        middle, side = (inner + outer) / 2, -int(np.sign(index))
        _tracks(decals, road, middle, side, base, wear.tracks, rng)
        _patches(decals, road, (inner, outer), side, base, wear.patches, rng)
        _covers(decals, road, middle, side, wear.covers, rng)
        _cracks(decals, road, (inner, outer), side, base, wear.cracks, rng)


def wear_turns(decals: Decals, lanes: list[Lane], wear: Wear, clear: shapely.Geometry) -> None:
    """Tyre tracks through a junction, as one dark shape so that crossing ones do not overlap.

    `clear` is kept free: roads that have tracks of their own.
    """
    strips = []
    for lane in lanes:
        for offset in (0.82, -0.82):
            track = shapely.LineString(lane.centreline[:, :2]).offset_curve(offset)
            strips.append(track.buffer(0.3, cap_style="flat"))
    region = shapely.union_all(strips).difference(clear)
    decals.polygon(region, _TRACKS, np.array(wear.colour) * (1 - 0.13 * wear.tracks), "asphalt")


def _tracks(
    decals: Decals, road: Road, middle: float, side: int, base: Array, share: float, rng: Generator
) -> None:
    s = road.stations(road.paved[0] + 0.5, road.paved[1] - 0.5, 5.0)
    drift = 0.12 * _wander(len(s), rng)
    shade = 1 + 0.05 * _wander(len(s) - 1, rng)
    for wheel in (0.82, -0.82):
        for (outer, bright), inner in zip(_SOFT, (0.34, 0.18, 0.0), strict=True):
            colours = base * (1 - share * (1 - bright)) * shade[:, None]
            for sign in (1.0, -1.0):
                far = road.point(s, middle + drift + wheel + sign * outer, side)
                near = road.point(s, middle + drift + wheel + sign * inner, side)
                left, right = (far, near) if sign > 0 else (near, far)
                decals.strip(left, right, _TRACKS, colours, "asphalt")


def _patches(
    decals: Decals, road: Road, lane: tuple[float, float], side: int, base: Array, rate: float,
    rng: Generator,
) -> None:  # fmt: skip
    low, high = sorted(lane)
    s = road.start + rng.uniform(0, 20)
    while rate > 0 and s < road.end - 12:
        if rng.random() < 0.3:  # a trench along the lane
            length, width = rng.uniform(5, 18), rng.uniform(0.5, 0.9)
        else:
            length, width = rng.uniform(0.8, 4.0), rng.uniform(0.7, high - low - 0.4)
        length = min(length, road.end - s - 1)
        start = rng.uniform(low + 0.1, high - width - 0.1)
        tone = base * rng.choice([rng.uniform(0.55, 0.8), rng.uniform(1.12, 1.4)])
        stations = road.stations(s, s + length)
        left = road.point(stations, start + width, side)
        right = road.point(stations, start, side)
        decals.strip(left, right, _PATCHES, tone, "asphalt")
        s += length + rng.exponential(100 / rate)


def _covers(
    decals: Decals, road: Road, middle: float, side: int, rate: float, rng: Generator
) -> None:
    s = road.start + rng.uniform(3, 40)
    while rate > 0 and s < road.end - 3:
        centre = road.point(s, middle + rng.uniform(-0.5, 0.5), side)
        for radius, tone, lift in ((0.42, 0.075, 0.0), (0.33, 0.05, 2e-4), (0.2, 0.09, 4e-4)):
            disc = shapely.Point(centre).buffer(radius, quad_segs=4)
            decals.polygon(disc, _COVERS + lift, [tone, tone * 0.97, tone * 0.93], "asphalt")
        s += 8 + rng.exponential(100 / rate)


def _cracks(
    decals: Decals, road: Road, lane: tuple[float, float], side: int, base: Array, rate: float,
    rng: Generator,
) -> None:  # fmt: skip
    low, high = sorted(lane)
    s = road.start + rng.exponential(8)
    while rate > 0 and s < road.end - 12:
        if rng.random() < 0.55:  # across the lane
            lateral = np.linspace(low, high, 9)
            along = s + 0.25 * _wander(9, rng) + rng.uniform(-0.15, 0.15) * np.arange(9)
            width = np.array([rng.uniform(0.012, 0.032), 0.0])
        else:
            along = s + np.linspace(0.0, rng.uniform(3.0, 10.0), 14)
            lateral = np.clip(rng.uniform(low, high) + 0.3 * _wander(14, rng), low, high)
            width = np.array([0.0, rng.uniform(0.012, 0.032)])
        one = road.point(along + width[0], lateral + width[1], side)
        other = road.point(along - width[0], lateral - width[1], side)
        _upwards(decals, one, other, base * rng.uniform(0.35, 0.6))
        s += rng.exponential(100 / rate)


def _upwards(decals: Decals, left: Array, right: Array, colour: Array) -> None:
    """A strip whose sides may have been given the wrong way round."""
    across, along = left[0] - right[0], right[1] - right[0]
    if along[0] * across[1] - along[1] * across[0] < 0:
        left, right = right, left
    decals.strip(left, right, _SEALS, colour, "asphalt")


def _wander(count: int, rng: Generator) -> Array:
    """A smooth random walk (count,) of about unit size."""
    steps = rng.normal(size=count + 8)
    smooth: Array = np.convolve(steps, np.ones(9) / 3.0, mode="valid")
    return smooth
