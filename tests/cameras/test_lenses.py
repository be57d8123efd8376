"""Lenses against OpenCV and NCore, and against themselves backwards."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from ncore.impl.data import types as ncore
from ncore.impl.sensors.camera import FThetaCameraModel, OpenCVFisheyeCameraModel

from recast.cameras import RadialLens, RationalLens
from recast.cameras.lenses import fisheye_lens, ftheta_lens

RATIONAL = RationalLens(
    1920, 1080, 1000.0, 1010.0, 955.0, 547.0,
    (0.3, 0.1, 0.02, 0.35, 0.12, 0.03), (0.001, -0.002), (0.001, -0.0005, 0.0008, 0.0003),
)  # fmt: skip
FISHEYE = fisheye_lens(1280, 960, 400.0, 410.0, 630.0, 470.0, (0.05, -0.01, 0.002, -0.0003), 1.7)
# A front camera of 120 degrees, as NVIDIA's cars have it.
FORWARD, BACKWARD = (0.0, 1838.0, 42.0, -26.0, -90.0, 18.0), (0.0, 5.4e-4, -6e-9, 3e-12, 2e-15, 0.0)
CDE = (1.0005, 0.0003, -0.0002)
ANGLES = ftheta_lens(3848, 2168, 1922.3, 1075.6, BACKWARD, "angle", 1.2, CDE)
DISTANCES = ftheta_lens(3848, 2168, 1922.3, 1075.6, FORWARD, "distance", 1.2, CDE)
LENSES = {"rational": RATIONAL, "fisheye": FISHEYE, "angles": ANGLES, "distances": DISTANCES}
NUMBERS = st.floats(-1.0, 1.0)


def pixels_of(lens: RationalLens | RadialLens, count: int = 400) -> np.ndarray:
    return np.random.default_rng(0).uniform(0, 1, (count, 2)) * [lens.width, lens.height]


@pytest.mark.parametrize("name", LENSES)
def test_rays_and_pixels_are_inverse_within_the_limit(name: str) -> None:
    lens = LENSES[name]
    pixels = pixels_of(lens)
    rays = lens.rays(pixels)
    seen = np.isfinite(rays[:, 0])
    assert seen.mean() > 0.7
    np.testing.assert_allclose(np.linalg.norm(rays[seen], axis=-1), 1.0, rtol=0, atol=1e-14)
    # A pixel's coordinate is known to 4000 * 2^-53; the polynomials lose three digits more.
    np.testing.assert_allclose(lens.project(7.0 * rays[seen]), pixels[seen], rtol=0, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.tuples(*[NUMBERS] * 12), st.tuples(NUMBERS, NUMBERS))
def test_any_rational_lens_gives_a_ray_that_comes_back_or_none(
    numbers: tuple[float, ...], place: tuple[float, float]
) -> None:
    radial = tuple(0.4 * number for number in numbers[:6])
    lens = RationalLens(
        200, 100, 90.0, 95.0, 100.0, 50.0, radial,
        tuple(0.01 * n for n in numbers[6:8]), tuple(0.01 * n for n in numbers[8:]),
    )  # fmt: skip
    lens.validate()
    pixel = np.array([100.0, 50.0]) * (1 + np.array(place))
    ray = lens.rays(pixel)
    if np.isfinite(ray[0]):
        np.testing.assert_allclose(lens.project(ray), pixel, rtol=0, atol=1e-6)
    middle = lens.rays([100.0, 50.0])
    np.testing.assert_allclose(middle, [0.0, 0.0, 1.0], rtol=0, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.tuples(*[NUMBERS] * 4), st.floats(0.2, np.pi), st.floats(0.0, 1.0), st.booleans())
@example((0.0, 0.0, -0.5380625888073881, 0.9999999999999999), 2.00001, 1.0, False)  # on the limit
def test_any_radial_lens_gives_an_angle_that_comes_back_or_none(
    numbers: tuple[float, ...], most: float, share: float, angles: bool
) -> None:
    polynomial = (0.0, 1.0, *(0.2 * number for number in numbers))
    lens = RadialLens(
        200, 100, 100.0, 50.0, ((80.0, 1.0), (-1.0, 78.0)), polynomial,
        "angle" if angles else "distance", most,
    )  # fmt: skip
    lens.validate()
    ray = np.array([np.sin(share * most) * 0.6, np.sin(share * most) * 0.8, np.cos(share * most)])
    pixel = lens.project(ray)
    if np.isfinite(pixel[0]):
        # Where the polynomial hardly grows, angles are known less well than pixels.
        np.testing.assert_allclose(lens.project(lens.rays(pixel)), pixel, rtol=0, atol=1e-6)


def test_the_rational_model_is_opencvs_up_to_the_pixel_centre() -> None:
    lens = RATIONAL
    points = lens.rays(pixels_of(lens)) * 9.0
    half = np.array([[lens.fx, 0, lens.cx - 0.5], [0, lens.fy, lens.cy - 0.5], [0, 0, 1]])
    k, p, s = lens.radial, lens.tangential, lens.thin_prism
    distortion = np.array([k[0], k[1], *p, k[2], *k[3:], *s])
    wanted, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), half, distortion)
    np.testing.assert_allclose(lens.project(points) - 0.5, wanted[:, 0], rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["fisheye", "angles", "distances"])
def test_fisheye_and_ftheta_are_ncores(name: str) -> None:
    lens = LENSES[name]
    assert isinstance(lens, RadialLens)
    size, shutter = np.array([lens.width, lens.height], np.uint64), ncore.ShutterType.GLOBAL
    model: FThetaCameraModel | OpenCVFisheyeCameraModel
    if name == "fisheye":
        model = OpenCVFisheyeCameraModel(
            ncore.OpenCVFisheyeCameraModelParameters(
                resolution=size, shutter_type=shutter, external_distortion_parameters=None,
                principal_point=np.array([630.0, 470.0], np.float32),
                focal_length=np.array([400.0, 410.0], np.float32),
                radial_coeffs=np.array([0.05, -0.01, 0.002, -0.0003], np.float32), max_angle=1.7,
            ), torch.device("cpu"),
        )  # fmt: skip
    else:
        kinds = ncore.FThetaCameraModelParameters.PolynomialType
        model = FThetaCameraModel(
            ncore.FThetaCameraModelParameters(
                resolution=size, shutter_type=shutter, external_distortion_parameters=None,
                principal_point=np.array([1921.8, 1075.1], np.float32),  # of pixel centres
                reference_poly=getattr(
                    kinds, "PIXELDIST_TO_ANGLE" if name == "angles" else "ANGLE_TO_PIXELDIST"
                ),
                pixeldist_to_angle_poly=np.array(BACKWARD, np.float32),
                angle_to_pixeldist_poly=np.array(FORWARD, np.float32),
                max_angle=1.2, linear_cde=np.array(CDE, np.float32),
            ), torch.device("cpu"),
        )  # fmt: skip
    pixels = pixels_of(lens).astype(np.float32)
    wanted = model.image_points_to_camera_rays(pixels).numpy()
    found = lens.rays(pixels)
    seen = np.isfinite(found[:, 0])
    # float32 there: pixels to 2e-4, which are 4e-7 of a focal length, and coefficients to 6e-8
    # of angles to 1.7; its inversion of a polynomial stops after a few steps.
    np.testing.assert_allclose(found[seen], wanted[seen], rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", LENSES)
def test_a_resized_image_has_the_same_rays(name: str) -> None:
    lens = LENSES[name]
    small = lens.resized(320, 512)  # the two axes by different factors
    assert (small.width, small.height) == (320, 512)
    pixels = pixels_of(lens)
    there = pixels * [320 / lens.width, 512 / lens.height]
    np.testing.assert_allclose(small.rays(there), lens.rays(pixels), rtol=0, atol=1e-12)


def test_there_are_no_rays_beyond_the_limit() -> None:
    edge = FISHEYE.project([np.sin(1.69), 0.0, np.cos(1.69)])
    assert np.isfinite(edge).all()
    assert np.isnan(FISHEYE.project([np.sin(1.71), 0.0, np.cos(1.71)])).all()
    assert np.isnan(FISHEYE.rays(2 * edge - [FISHEYE.cx, FISHEYE.cy])).all()
    # r (1 - 0.2 r^2) turns back at r = 1.29, where it is 0.86.
    folding = replace(RATIONAL, radial=(-0.2, 0.0, 0.0, 0.0, 0.0, 0.0), tangential=(0.0, 0.0),
                      thin_prism=(0.0,) * 4)  # fmt: skip
    assert np.isfinite(folding.rays([folding.cx + 850.0, folding.cy])).all()
    assert np.isnan(folding.rays([folding.cx + 870.0, folding.cy])).all()
    assert np.isnan(folding.project([1.4, 0.0, 1.0])).all()
    assert np.isnan(RATIONAL.project([0.0, 0.0, -1.0])).all()


@pytest.mark.parametrize(
    ("lens", "field"),
    [
        (replace(RATIONAL, fx=0.0), "fx, fy"),
        (replace(RATIONAL, radial=(0.1,)), "radial: expected 6"),
        (replace(RATIONAL, thin_prism=(0.0, 0.0, np.nan, 0.0)), "thin_prism"),
        (replace(FISHEYE, max_angle=0.0), "max_angle"),
        (replace(FISHEYE, max_angle=3.3), "max_angle"),
        (replace(FISHEYE, polynomial=(0.0, -1.0)), "polynomial: does not grow"),
        (replace(ANGLES, matrix=((1.0, 1.0), (1.0, 1.0))), "matrix"),
        (replace(ANGLES, polynomial=(0.0, 1e-9)), "too long"),
        (replace(ANGLES, width=1 << 20, height=1 << 20), "width, height"),
    ],
)
def test_what_is_no_lens_is_named(lens: RationalLens | RadialLens, field: str) -> None:
    with pytest.raises(ValueError, match=field):
        lens.validate()
