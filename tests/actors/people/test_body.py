"""The body stands, steps and rides as bodies do, whatever its build."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.actors.people.body import (
    PHASES,
    WHEEL_RADIUS,
    PersonShape,
    Region,
    part_poses,
    surface_of,
)
from recast.geometry import se3

walkers = st.builds(
    lambda height, girth, stride, pack: PersonShape(height, girth, pack, cycle=stride * height),
    st.floats(1.0, 2.05),
    st.floats(0.75, 1.35),
    st.floats(0.55, 1.1),
    st.booleans(),
)


@settings(max_examples=15, deadline=None)
@given(shape=walkers)
def test_a_walker_stands_on_the_ground_at_every_phase(shape: PersonShape) -> None:
    surface = surface_of(shape, 0.05)
    for motion in surface.motions[:: PHASES // 8]:
        moved = np.einsum("nj,jab->nab", surface.weights, motion)
        z = (moved[:, 2, :3] * surface.points).sum(axis=1) + moved[:, 2, 3]
        assert (
            abs(z.min()) < 0.025 * shape.height
        )  # the sole's curve, and patches beside its lowest point
        assert 0.9 * shape.height < z.max() < 1.04 * shape.height


@settings(max_examples=15, deadline=None)
@given(shape=walkers)
def test_steps_repeat_and_sides_alternate(shape: PersonShape) -> None:
    at_start, half, whole = (part_poses(shape, phase) for phase in (0.1, 0.6, 1.1))
    np.testing.assert_allclose(whole, at_start, atol=1e-9)
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    left, right = half[2:7], mirror @ at_start[7:12] @ mirror
    np.testing.assert_allclose(left, right, atol=1e-9)


def test_a_foot_on_the_ground_hardly_slips() -> None:
    shape = PersonShape(1.75, cycle=1.4)
    phases = np.arange(201) / 200
    soles = shape.height * np.array([[-0.045, 0.0, -0.039], [0.107, 0.0, -0.039]])
    poses = np.array([part_poses(shape, phase) for phase in phases])
    points = np.concatenate([se3.apply(poses[:, k], soles) for k in (4, 9)], axis=1)
    points[..., 0] += shape.cycle * phases[:, None]
    lowest = points[:-1, :, 2].argmin(axis=1)
    rows = np.arange(200)
    moved = points[1:][rows, lowest, 0] - points[:-1][rows, lowest, 0]
    # A cycle's way is 1.4 m: what is down moves by a tenth of it all in all.
    assert abs(moved.sum()) < 0.1 * shape.cycle


def test_limbs_keep_their_lengths_and_feet_the_pedals() -> None:
    shape = PersonShape(1.7, bicycle=1.75, top=1.65, cycle=5.2)
    for phase in np.linspace(0, 1, 9):
        poses = part_poses(shape, phase)
        for first in (2, 7):
            hip, knee, ankle = poses[first : first + 3, :3, 3]
            assert np.linalg.norm(knee - hip) == pytest.approx(0.245 * shape.height, rel=1e-6)
            assert np.linalg.norm(ankle - knee) == pytest.approx(0.246 * shape.height, rel=0.03)
        axle = poses[15, :3, 3]
        sides = [poses[k, :3, 3] - axle for k in (4, 9)]
        up = [side[2] - 0.039 * shape.height for side in sides]
        np.testing.assert_allclose(up[0], -up[1], atol=1e-9)  # one pedal down, the other up


@given(st.floats(0, 30))
def test_wheels_do_not_slip(phase: float) -> None:
    shape = PersonShape(1.7, bicycle=1.75, top=1.65, cycle=5.2)
    wheel = part_poses(shape, phase)[13, :3, :3] @ part_poses(shape, 0.0)[13, :3, :3].T
    rolled = shape.cycle * phase / WHEEL_RADIUS
    np.testing.assert_allclose(wheel[0, 2], np.sin(rolled), atol=1e-6)  # top goes ahead


@pytest.mark.parametrize("bicycle", [0.0, 1.75])
def test_patches_have_outward_normals_twins_and_weights(bicycle: float) -> None:
    surface = surface_of(PersonShape(1.75, pack=True, bicycle=bicycle, top=1.7), 0.03)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(surface.weights.sum(axis=1), 1)
    assert surface.weights.min() >= 0
    lacking = set(Region) - set(surface.region)
    assert lacking == (set() if bicycle else {Region.FRAME, Region.TYRE, Region.METAL})
    face = (surface.region == Region.SKIN) & (surface.points[:, 2] > 1.55)
    middle = surface.points[face].mean(axis=0)
    outward = ((surface.points[face] - middle) * surface.normals[face]).sum(axis=1)
    assert (outward > 0).mean() > 0.9
    assert np.array_equal(surface.region[surface.twin], surface.region)
    arms = surface.region == Region.SKIN
    apart = surface.points[arms, 1] * surface.points[surface.twin[arms], 1]
    assert (apart <= 1e-6).mean() > 0.9  # the other hand, or the other half of the face


def test_nobody_is_too_small_or_tall_for_a_bicycle() -> None:
    for height in (1.0, 1.3, 1.72, 2.1):
        poses = part_poses(PersonShape(height, bicycle=1.36, top=1.3), 0.4)
        assert np.isfinite(poses).all()


@pytest.mark.parametrize("bicycle", [1.36, 1.75, 2.4])
def test_hands_are_on_the_grips(bicycle: float) -> None:
    for height in (1.5, 1.72, 1.9):
        shape = PersonShape(height, bicycle=bicycle, top=1.68)
        poses = part_poses(shape, 0.0)
        for elbow in (6, 11):
            end = se3.apply(poses[elbow], [[0.0, 0.0, -0.146 * height]])[0]
            assert end[2] == pytest.approx(1.04, abs=0.08)
            assert abs(end[1]) == pytest.approx(0.24, abs=0.06)
