"""The paper's orbit, and photographs that are brought to it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.core.errors import InputError
from recast.geometry import se3
from recast.metrics.actor_scores import (
    ORBIT_PIXELS,
    ActorCase,
    ActorView,
    drawn,
    elevation_deg,
    orbit_case,
    photographed,
    read_cases,
    target_case,
)
from recast.metrics.oracle_scores import mask_iou
from recast.recar.views import camera_pose, pinhole
from recast.splats import CLASSIC
from support.crops import SIZE, photograph, two_coloured_box
from support.studies import write_vehicle_set


def still(picture: np.ndarray) -> np.ndarray:
    return picture


def case_of(picture: np.ndarray, fov_deg: float, distance: float, azimuth: float) -> ActorCase:
    height, width = picture.shape[:2]
    pose = se3.inverse(camera_pose(azimuth, 15.0, distance))
    view = ActorView("view", partial(still, picture), pinhole(width, height, fov_deg), pose)
    return ActorCase("car", "car", np.array(SIZE), (view,), (view,))


def test_the_camera_of_the_paper(tmp_path: Path) -> None:
    (first, *_) = read_cases(write_vehicle_set(tmp_path / "set"))
    orbit = target_case(first, "orbit")
    assert target_case(first, "set") is first
    assert orbit.inputs == first.inputs
    assert len(orbit.targets) == 4
    for view, before in zip(orbit.targets, first.targets, strict=True):
        camera = view.camera
        assert (camera.width, camera.height) == (512, 512)
        assert 2 * np.degrees(np.arctan(256 / camera.fx)) == pytest.approx(40)
        eye = se3.inverse(view.camera_from_actor)[:3, 3]
        assert np.linalg.norm(eye) == pytest.approx(2 * SIZE[0])
        assert elevation_deg(view) == pytest.approx(15)
        assert view.azimuth_deg == pytest.approx(before.azimuth_deg)
        assert view.load().shape == (512, 512, 4)


@pytest.mark.parametrize(("azimuth", "width"), [(0.0, 200), (48.0, 900)])
def test_photographs_lie_on_what_is_drawn(azimuth: float, width: int) -> None:
    """From the orbit's own distance, at any size and angle of view, nothing but sampling differs;
    from another one, perspective does."""
    box = two_coloured_box()

    def overlap(distance: float) -> float:
        camera = pinhole(width, round(0.7 * width), 55.0)
        picture = photograph(box, azimuth, 15.0, camera, distance)
        picture[picture[..., 3] == 0] = 0
        (view,) = orbit_case(case_of(picture, 55.0, distance, azimuth)).targets
        return mask_iou(drawn(box, CLASSIC, view).mask, photographed(view.load()).mask)

    same = overlap(2 * SIZE[0])
    assert same > (0.95 if width == 200 else 0.98)
    assert overlap(1.2 * SIZE[0]) < same - 0.02


@given(st.floats(0.3, 6.0), st.floats(10.0, 80.0))
@settings(max_examples=15, deadline=None)
def test_area_and_colour_are_kept(distance: float, fov_deg: float) -> None:
    """A half-transparent square about the centre, as wide as an eighth of the picture."""
    distance *= SIZE[0]
    picture = np.zeros((96, 96, 4), np.uint8)
    picture[42:54, 42:54] = (200, 100, 50, 128)
    (view,) = orbit_case(case_of(picture, fov_deg, distance, 30.0)).targets
    found = view.load()
    side = (12 / 96) * 2 * distance * np.tan(np.radians(fov_deg) / 2)  # metres at the centre
    pixels = side / (2 * 2 * SIZE[0] * np.tan(np.radians(20))) * ORBIT_PIXELS
    area = float((found[..., 3] / 128).sum())
    # At the square's edge, alpha below half a step is lost on either side. And a ramp of one pixel
    # of the photograph is sampled: its width in samples is off by up to 2 / pi of a sinc, of which
    # the first beyond a pixel is 0.22: 0.14 pixels, and less for all others together.
    edges = 4 * pixels * 0.02 + 2 * pixels * 2 * 0.14
    assert area == pytest.approx(min(pixels, ORBIT_PIXELS) ** 2, rel=0.02, abs=edges)
    middle = found[ORBIT_PIXELS // 2, ORBIT_PIXELS // 2]
    if pixels > 4:
        assert np.abs(middle.astype(int) - (200, 100, 50, 128)).max() <= 1
    rows = np.flatnonzero(found[..., 3].any(axis=1))
    assert abs(rows[0] + rows[-1] + 1 - ORBIT_PIXELS) <= 1


def test_a_camera_that_looks_elsewhere_is_refused() -> None:
    picture = np.full((40, 60, 4), 255, np.uint8)
    case = case_of(picture, 40.0, 8.0, 0.0)
    pose = case.targets[0].camera_from_actor.copy()
    pose[0, 3] += 0.1
    for view in (
        replace(case.targets[0], camera_from_actor=pose),
        replace(case.targets[0], camera=case.targets[0].camera.cropped(4, 0, 40, 40)),
    ):
        with pytest.raises(InputError, match="car/view: camera: does not look at the box centre"):
            orbit_case(replace(case, targets=(view,)))
