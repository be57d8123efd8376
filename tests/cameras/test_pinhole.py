"""Pinhole cameras."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.cameras import PinholeCamera
from recast.cameras.pinhole import distort, undistort

NUPLAN = (-0.356123, 0.172545, -0.002130, 0.000464, -0.052310)
CAMERAS = {
    "rectified": PinholeCamera(1242, 375, 721.5, 721.5, 609.6, 172.9),
    "nuplan": PinholeCamera(1920, 1080, 1545.0, 1545.0, 960.0, 560.0, NUPLAN),
    "kitti raw": PinholeCamera(
        1392, 512, 984.2, 980.8, 690.0, 233.2, (-0.3728755, 0.2037299, 0.00222, 0.00138, -0.07233)
    ),
    "waymo": PinholeCamera(
        1920, 1280, 2059.0, 2059.0, 935.1, 635.1, (0.0398, -0.3376, 0.0013, -0.0002, 0.0)
    ),
}
fractions = st.tuples(st.floats(0, 1), st.floats(0, 1))


@given(st.sampled_from(list(CAMERAS)), fractions, st.floats(0.1, 200))
def test_unproject_and_project_are_inverse(name, fraction, depth):
    camera = CAMERAS[name]
    pixel = np.array(fraction) * [camera.width, camera.height]
    point = camera.unproject(pixel, depth)
    assert point[2] == depth
    found, found_depth = camera.project(point)
    np.testing.assert_allclose(found, pixel, rtol=0, atol=1e-7)
    assert found_depth == depth


@pytest.mark.parametrize("name", CAMERAS)
def test_projection_is_opencvs_up_to_the_pixel_centre(name):
    camera = CAMERAS[name]
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0, 1, (200, 2)) * [camera.width, camera.height]
    points = camera.unproject(pixels, rng.uniform(1, 80, 200))
    half = camera.matrix - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    wanted, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), half, camera.distortion)
    found, _ = camera.project(points)
    np.testing.assert_allclose(found - 0.5, wanted[:, 0], rtol=0, atol=1e-6)


@given(st.floats(-1.0, 1.0), st.floats(-0.7, 0.7))
def test_undistort_inverts_distort(x, y):
    np.testing.assert_allclose(undistort(distort([x, y], NUPLAN), NUPLAN), [x, y], atol=1e-9)


def test_points_beside_a_wide_camera_do_not_fold_into_the_picture():
    """The polynomial alone would put a point 80 degrees to the side into the image."""
    camera = CAMERAS["nuplan"]
    angles = np.radians(np.linspace(0, 89, 90))
    points = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=-1)
    pixels, _ = camera.project(points)
    assert np.all(np.diff(pixels[:, 0]) > 0)
    assert np.all(pixels[angles > np.radians(45), 0] > camera.width)


def test_points_behind_have_negative_depth_and_finite_pixels():
    pixels, depth = CAMERAS["rectified"].project([[1.0, 1.0, -5.0], [1.0, 1.0, 0.0]])
    assert depth.tolist() == [-5.0, 0.0] and np.all(np.isfinite(pixels))


def test_resizing_keeps_corners_and_centres():
    """With pixel centres at +0.5, the image's corners (0, 0) and (w, h) map to themselves."""
    camera = CAMERAS["rectified"]
    half = camera.resized(621, 188)
    point = np.array([2.0, 1.0, 10.0])
    pixel, _ = camera.project(point)
    scaled, _ = half.project(point)
    np.testing.assert_allclose(scaled, pixel * [621 / 1242, 188 / 375])


def test_cropping_shifts_pixels():
    camera = CAMERAS["nuplan"]
    point = np.array([0.3, 0.2, 10.0])
    pixel, _ = camera.project(point)
    cropped, _ = camera.cropped(100, 50, 800, 600).project(point)
    np.testing.assert_allclose(cropped, pixel - [100, 50])


def test_pixel_grid_holds_centres():
    grid = CAMERAS["rectified"].resized(4, 3).pixel_grid()
    assert grid.shape == (3, 4, 2)
    np.testing.assert_array_equal(grid[2, 3], [3.5, 2.5])


@pytest.mark.parametrize(
    ("field", "change"),
    [("width", {"width": 0}), ("fx", {"fx": -1.0}), ("distortion", {"distortion": (0.0, np.nan)})],
)
def test_validation_names_the_field(field, change):
    values = {"width": 4, "height": 3, "fx": 1.0, "fy": 1.0, "cx": 2.0, "cy": 1.5}
    with pytest.raises(ValueError, match=field):
        PinholeCamera(**{**values, **change}).validate()
