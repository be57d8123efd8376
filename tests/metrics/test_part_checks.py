"""Part checks on drawn cars: a clean one passes, each fault fails its own check."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import cv2
import numpy as np
import pytest

from recast.arrays import Array, Image
from recast.geometry import se3
from recast.metrics.actor_scores import ActorView, ScoredCutout
from recast.metrics.part_checks import (
    PartCheck,
    paint_colours,
    part_checks,
    passed_share,
    side_picture,
    wheel_places,
)
from recast.recar.views import camera_pose, pinhole

SIZE = (4.4, 1.8, 1.5)
PAINT, GLASS, TYRE, RIM, RED = (
    np.array(colour) / 255
    for colour in ((170, 172, 176), (40, 45, 50), (18, 18, 20), (150, 152, 155), (170, 20, 25))
)
WHITE = np.ones(3)


class Car:
    """A car whose one side is drawn flat into the picture of a camera before it."""

    def __init__(self, azimuth: float) -> None:
        self.camera = pinhole(500, 400, 40.0)
        self.pose = se3.inverse(camera_pose(azimuth, 8.0, 7.0))
        turn = se3.rotation_z(np.radians(azimuth))
        self.depth = (SIZE[0] if azimuth in (0.0, 180.0) else SIZE[1]) / 2 - 0.06
        self.turn = turn
        self.rgb, self.alpha = np.zeros((400, 500, 3)), np.zeros((400, 500))

    @property
    def view(self) -> ActorView:
        return ActorView("drawn", lambda: cast("Image", None), self.camera, self.pose)

    def fill(self, outline: Sequence[tuple[float, float]], colour: Array) -> None:
        """A polygon of metres to the right of the middle and above the ground."""
        flat = np.array([(self.depth, right, up - SIZE[2] / 2) for right, up in outline])
        pixels, _ = self.camera.project(flat @ self.turn.T @ self.pose[:3, :3].T + self.pose[:3, 3])
        mask = np.zeros(self.alpha.shape, np.uint8)
        cv2.fillPoly(mask, [np.round(pixels).astype(np.int32)], 1)
        self.rgb[mask > 0], self.alpha[mask > 0] = colour, 1.0

    def disc(self, right: float, up: float, radius: float, colour: Array) -> None:
        angles = np.linspace(0, 2 * np.pi, 40)
        ring = zip(right + radius * np.cos(angles), up + radius * np.sin(angles), strict=True)
        self.fill([(float(x), float(y)) for x, y in ring], colour)

    def rectangle(self, left: float, low: float, right: float, high: float, colour: Array) -> None:
        self.fill([(left, low), (right, low), (right, high), (left, high)], colour)

    @property
    def cutout(self) -> ScoredCutout:
        return ScoredCutout(self.rgb * self.alpha[..., None], self.alpha)


def side(wheels: Sequence[float] = (-1.3, 1.3), pane: Array = GLASS) -> Car:
    car = Car(90.0)
    car.fill([(-2.2, 0.2), (2.2, 0.2), (2.2, 0.85), (1.5, 1.45), (-1.2, 1.45), (-2.2, 0.85)], PAINT)
    car.fill([(-1.7, 0.92), (1.6, 0.92), (1.3, 1.36), (-1.1, 1.36)], pane)
    for x in wheels:
        car.disc(x, 0.33, 0.33, TYRE)
        car.disc(x, 0.33, 0.20, RIM)
    return car


def rear(lamps: Sequence[float] = (0.85,), plate: float | None = 0.55) -> Car:
    car = Car(180.0)
    car.rectangle(-0.9, 0.1, 0.9, 1.45, PAINT)
    car.rectangle(-0.7, 1.0, 0.7, 1.38, GLASS)
    car.rectangle(-0.5, 0.4, 0.5, 0.7, GLASS)
    for up in lamps:
        for x in (-0.75, 0.75):
            car.rectangle(x - 0.12, up - 0.1, x + 0.12, up + 0.1, RED)
    if plate is not None:
        car.rectangle(-0.26, plate - 0.06, 0.26, plate + 0.06, WHITE)
    return car


def front(lamp: bool = True) -> Car:
    car = Car(0.0)
    car.rectangle(-0.9, 0.1, 0.9, 1.45, PAINT)
    car.rectangle(-0.7, 1.0, 0.7, 1.38, GLASS)
    car.rectangle(-0.4, 0.5, 0.4, 0.75, GLASS)
    for x in (-0.68, 0.68) if lamp else ():
        car.rectangle(x - 0.18, 0.6, x + 0.18, 0.78, GLASS)
        car.disc(x, 0.69, 0.06, WHITE)
    return car


def smeared(car: Car) -> Car:
    car.rgb = np.asarray(cv2.GaussianBlur(car.rgb, (0, 0), 12), np.float64)
    return car


def checks(shown: Car, real: Car) -> dict[str, PartCheck]:
    paints = paint_colours([shown.cutout])[0], paint_colours([real.cutout])[0]
    found = part_checks(shown.cutout, real.cutout, real.view, SIZE, paints)
    return {check.part: check for check in found}


@pytest.mark.parametrize(
    ("make", "parts"),
    [
        (side, {"windows", "wheels"}),
        (rear, {"windows", "tail lamps", "plate"}),
        (front, {"windows", "head lamps", "plate"}),
    ],
)
def test_the_very_car_passes(make: Callable[[], Car], parts: set[str]) -> None:
    found = checks(make(), make())
    assert set(found) == parts
    # the front has no plate: the photograph does not decide that one, and it is counted
    undecided = {part for part, check in found.items() if check.passed is None}
    assert undecided == ({"plate"} if make is front else set())
    assert passed_share(list(found.values()))[1:] == (len(parts) - len(undecided), len(undecided))
    assert all(check.passed for part, check in found.items() if part not in undecided)


@pytest.mark.parametrize(
    ("fault", "real", "part"),
    [
        (side((-1.3, -1.0, 1.3)), side(), "wheels"),  # two wheels on one arch
        (side((-1.3, 1.0)), side(), "wheels"),  # one wheel beside its place
        (side((1.3,)), side(), "wheels"),
        (side(pane=PAINT), side(), "windows"),  # panes in the body's colour
        (side(pane=WHITE), side(), "windows"),  # panes far lighter than photographed
        (rear((0.85, 0.52)), rear(), "tail lamps"),  # four lamps
        (rear(()), rear(), "tail lamps"),
        (rear((0.55,)), rear(), "tail lamps"),  # lamps 0.3 m below their place
        (smeared(rear()), rear(), "tail lamps"),
        (rear(plate=None), rear(), "plate"),
        (front(lamp=False), front(), "head lamps"),
        (smeared(front()), front(), "head lamps"),
    ],
)
def test_a_fault_fails_its_check(fault: Car, real: Car, part: str) -> None:
    found = checks(fault, real)[part]
    assert found.passed is False and found.reason


def test_nothing_drawn_fails_and_a_red_car_does_not_decide_its_lamps() -> None:
    assert not any(check.passed for check in checks(Car(90.0), side()).values())
    red = rear()
    red.rgb[np.abs(red.rgb - PAINT).sum(axis=-1) < 0.01] = RED
    assert checks(red, red)["tail lamps"].passed is None


def test_panes_of_coloured_paint_are_neither_its_highlights_nor_full_of_holes() -> None:
    def red(glare: Array) -> Car:
        car = side()
        car.rgb[np.abs(car.rgb - PAINT).sum(axis=-1) < 0.01] = np.array([0.45, 0.12, 0.10])
        car.rectangle(-2.0, 0.78, 2.0, 0.9, glare)
        car.rectangle(-0.4, 1.05, -0.1, 1.25, np.array([0.45, 0.12, 0.10]))  # mirrored in a pane
        return car

    lit, plain = red(np.array([0.80, 0.24, 0.20])), red(np.array([0.45, 0.12, 0.10]))
    assert checks(lit, plain)["windows"].passed
    paint = paint_colours([lit.cutout])[0]
    picture = side_picture(lit.cutout, lit.view, SIZE, "left", paint)
    assert picture is not None
    up = picture.low[1] + (picture.mask.shape[0] - np.arange(picture.mask.shape[0])) / 80
    panes = picture.panes()
    assert not panes[up < 0.88].any()
    row = panes[np.argmin(np.abs(up - 1.15))]
    columns = np.flatnonzero(row)
    assert row[columns[0] : columns[-1]].all()


def test_paint_is_that_of_the_panels_where_a_pane_fills_the_picture() -> None:
    glass = front()
    glass.rectangle(-0.7, 0.72, 0.7, 1.38, np.array([0.33, 0.34, 0.36]))
    colours = paint_colours([glass.cutout, side().cutout, side().cutout])
    assert np.abs(np.ptp(colours[:, 0])) < 3.0


def test_wheels_are_found_in_metres() -> None:
    car = side()
    picture = side_picture(car.cutout, car.view, SIZE, "left", paint_colours([car.cutout])[0])
    assert picture is not None
    assert wheel_places(picture) == pytest.approx([-1.3, 1.3], abs=0.04)
    assert side_picture(car.cutout, car.view, SIZE, "front", picture.paint) is None
