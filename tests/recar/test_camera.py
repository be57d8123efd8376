from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.cameras import box_rectangle
from recast.geometry import se3
from recast.recar import Identity, camera_pose, fitting_distance, pinhole
from support.vehicle_sets import identity_record, set_record

FRONT, LEFT, TOP = np.array([2.0, 0, 0]), np.array([0, 0.9, 0]), np.array([0, 0, 0.7])


def pixel(point: np.ndarray, view: int) -> np.ndarray:
    record = set_record(1)
    camera, actor_from_camera = Identity(Path(), identity_record(0), record).camera(view)
    pixels, depth = camera.project(se3.apply(se3.inverse(actor_from_camera), point[None]))
    assert depth[0] > 0
    return pixels[0]


def test_from_ahead_the_left_side_is_to_the_right() -> None:
    centre = pixel(np.zeros(3), 0)
    assert centre == pytest.approx([24.0, 16.0])
    assert pixel(LEFT, 0)[0] > 24.0
    assert pixel(FRONT, 0)[0] == pytest.approx(24.0)
    assert pixel(FRONT, 0)[1] > 16.0  # nearer, below the line of sight
    assert pixel(TOP, 0)[1] < 16.0


def test_from_the_left_the_front_points_left() -> None:
    assert pixel(FRONT, 1)[0] < 24.0
    assert pixel(LEFT, 1)[0] == pytest.approx(24.0)


def test_from_behind_and_from_the_right() -> None:
    assert pixel(LEFT, 2)[0] < 24.0
    assert pixel(FRONT, 3)[0] > 24.0


def test_the_camera_stands_where_azimuth_and_elevation_say() -> None:
    _, pose = Identity(Path(), identity_record(0), set_record(1)).camera(1)
    expected = 8.0 * np.array([0, np.cos(np.radians(15)), np.sin(np.radians(15))])
    assert pose[:3, 3] == pytest.approx(expected)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)


def test_the_angle_of_view_is_across_the_width() -> None:
    camera = pinhole(1200, 800, 40.0)
    edge = camera.rays([[0.0, 400.0]])[0]
    assert np.degrees(np.arctan(-edge[0])) == pytest.approx(20.0)
    assert camera.fx == camera.fy


def test_a_view_that_is_not_there() -> None:
    with pytest.raises(IndexError, match="views 0 to 3"):
        Identity(Path(), identity_record(0), set_record(1)).camera(4)


@settings(deadline=None, max_examples=15)
@given(
    st.tuples(st.floats(1, 14), st.floats(0.5, 3), st.floats(0.5, 4)),
    st.sampled_from([(1200, 800), (256, 256), (60, 200)]),
    st.floats(-30, 60),
    st.integers(0, 359),
)
def test_the_box_fits_with_its_margin_and_no_more(
    size: tuple[float, float, float], pixels: tuple[int, int], elevation: float, azimuth: int
) -> None:
    camera = pinhole(*pixels, 40.0)
    distance = fitting_distance(size, camera, elevation, margin=0.05)

    def room(azimuth: float, at: float) -> float:
        """Least share of the image between the box and an edge."""
        rectangle = box_rectangle(size, se3.inverse(camera_pose(azimuth, elevation, at)), camera)
        assert rectangle is not None
        shares = rectangle / np.tile([camera.width, camera.height], 2)
        return float(min(shares[0], shares[1], 1 - shares[2], 1 - shares[3]))

    assert room(float(azimuth), distance) > 0.05 - 1e-9
    tightest = min(room(float(degrees), distance) for degrees in range(91))
    assert tightest == pytest.approx(0.05, abs=1e-6)
