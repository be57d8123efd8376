"""Oriented boxes."""

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import given
from hypothesis import strategies as st

from recast.cameras import PinholeCamera, box_rectangle
from recast.geometry import boxes, se2, se3

from .strategies import planar_poses, transforms

sizes = st.tuples(st.floats(0.1, 15), st.floats(0.1, 4), st.floats(0.1, 4)).map(np.array)
unit = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)
CAMERA = PinholeCamera(800, 600, 500.0, 500.0, 400.0, 300.0)
camera_from_rig = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


@given(sizes, transforms, unit)
def test_a_box_contains_its_corners_convex_hull(size, pose, fraction):
    inner = se3.apply(pose, (fraction * size / 2)[None])
    assert boxes.contains(inner, size, pose, margin=1e-9).all()
    assert boxes.contains(boxes.corners(size, pose), size, pose, margin=1e-9).all()
    outward = fraction.copy()
    outward[np.argmax(np.abs(fraction))] = 1.0 + 1e-6 + abs(fraction).max()
    assert not boxes.contains(se3.apply(pose, (outward * size / 2)[None]), size, pose).any()


@given(sizes, transforms)
def test_margin_is_in_metres(size, pose):
    point = se3.apply(pose, np.array([[size[0] / 2 + 0.5, 0, 0]]))
    assert boxes.contains(point, size, pose, margin=0.51).all()
    assert not boxes.contains(point, size, pose, margin=0.49).any()


def test_corner_order_and_edges():
    corners = boxes.corners([4.0, 2.0, 1.0])
    np.testing.assert_array_equal(corners[0], [2, 1, -0.5])  # front left, bottom
    np.testing.assert_array_equal(corners[6], [-2, -1, 0.5])  # rear right, top
    lengths = [np.linalg.norm(corners[i] - corners[j]) for i, j in boxes.EDGES]
    assert sorted(lengths) == [1.0] * 4 + [2.0] * 4 + [4.0] * 4


@given(planar_poses, sizes)
def test_bev_corners_are_the_bottom_face(pose, size):
    bottom = boxes.corners(size, se2.to_se3(pose))[:4, :2]
    np.testing.assert_allclose(boxes.bev_corners(pose, size[0], size[1]), bottom, atol=1e-9)


def test_bev_corners_broadcast():
    found = boxes.bev_corners(np.zeros((5, 7, 3)), 4.0, np.full((5, 1), 2.0))
    assert found.shape == (5, 7, 4, 2)


near_poses = st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-4, 4)).map(np.array)


@given(near_poses, sizes, near_poses, sizes)
def test_overlap_area_is_shapelys_and_symmetric(pose_a, size_a, pose_b, size_b):
    found = boxes.bev_overlap_area(pose_a, size_a, pose_b, size_b)
    first = shapely.Polygon(boxes.bev_corners(pose_a, *size_a[:2]))
    second = shapely.Polygon(boxes.bev_corners(pose_b, *size_b[:2]))
    assert found == pytest.approx(first.intersection(second).area, abs=1e-9)
    assert found == pytest.approx(boxes.bev_overlap_area(pose_b, size_b, pose_a, size_a), abs=1e-9)


@given(near_poses, sizes, near_poses, sizes, near_poses)
def test_overlap_does_not_depend_on_the_frame(pose_a, size_a, pose_b, size_b, move):
    moved_a, moved_b = se2.compose(100 * move, pose_a), se2.compose(100 * move, pose_b)
    moved = boxes.bev_overlap_area(moved_a, size_a, moved_b, size_b)
    found = boxes.bev_overlap_area(pose_a, size_a, pose_b, size_b)
    assert moved == pytest.approx(found, abs=1e-8)


def test_overlap_is_taken_pair_by_pair():
    poses = np.array([[0.0, 0, 0], [2, 0, 0], [9, 0, 0]])
    found = boxes.bev_overlap_area(poses, [4, 2], np.zeros(3), [[4, 2], [4, 1], [4, 2]])
    np.testing.assert_allclose(found, [8, 2, 0])


@given(near_poses, sizes)
def test_a_box_overlaps_itself_wholly(pose, size):
    area = boxes.bev_overlap_area(pose, size, pose, size)
    assert area == pytest.approx(size[0] * size[1], rel=1e-9)


def test_overlap_far_from_the_origin_keeps_its_digits():
    far = np.array([5e6, -4e6, 0.3])
    near = boxes.bev_overlap_area([0, 0, 0.3], [4, 2], [1, 0.5, 0.7], [4, 2])
    moved = boxes.bev_overlap_area(far, [4, 2], far + np.array([1, 0.5, 0.4]), [4, 2])
    assert moved == pytest.approx(near, abs=1e-8)


def test_touching_boxes_do_not_overlap():
    assert boxes.bev_overlap_area([0, 0, 0], [4, 2], [4, 0, np.pi], [4, 2]) < 1e-12
    assert boxes.bev_overlap_area([0, 0, 0], [4, 2], [4, 2, 0], [4, 2]) < 1e-12


def box_ahead(x, y=0.0, heading=0.0):
    return camera_from_rig @ se2.to_se3([x, y, heading])


def test_projection_of_a_box_ahead():
    left, top, right, bottom = box_rectangle([4.0, 2.0, 2.0], box_ahead(12.0), CAMERA)
    assert (left, right) == (400 - 50, 400 + 50)  # the near face, 10 m away
    assert (top, bottom) == (300 - 50, 300 + 50)


@given(st.floats(-20, 20), st.floats(-20, 20), st.floats(-4, 4), st.floats(0.05, 0.95))
def test_projection_bounds_every_visible_point_of_the_box(x, y, heading, fraction):
    size, pose = np.array([4.5, 1.9, 1.6]), box_ahead(x, y, heading)
    rng = np.random.default_rng(0)
    points = se3.apply(pose, rng.uniform(-0.5, 0.5, (200, 3)) * size)
    visible = points[points[:, 2] >= 0.1]
    rectangle = box_rectangle(size, pose, CAMERA)
    if rectangle is None:
        assert len(visible) == 0
        return
    assert np.all(np.isfinite(rectangle))
    if len(visible):
        pixels, _ = CAMERA.project(visible)
        assert np.all(pixels >= rectangle[:2] - 1e-6) and np.all(pixels <= rectangle[2:] + 1e-6)


def test_a_box_beside_the_camera_keeps_a_correct_outline():
    """Half of it lies behind the camera: its corners there would mirror to the other side."""
    rectangle = box_rectangle([6.0, 2.0, 1.5], box_ahead(1.0, 3.0), CAMERA)
    assert rectangle[2] < 400  # wholly to the left
    assert rectangle[0] < 0


def test_a_box_behind_is_not_seen():
    assert box_rectangle([4.0, 2.0, 1.5], box_ahead(-10.0), CAMERA) is None


@given(planar_poses, planar_poses)
def test_the_depth_is_the_shortest_way_out(a: np.ndarray, b: np.ndarray) -> None:
    b = np.array([a[0] + b[0] % 6 - 3, a[1] + b[1] % 6 - 3, b[2]])  # near enough to overlap
    size_a, size_b = np.array([5.0, 2.0]), np.array([4.0, 1.8])
    one, other = (
        shapely.Polygon(boxes.bev_corners(pose, *size)) for pose, size in ((a, size_a), (b, size_b))
    )
    depth = float(boxes.bev_depth(a, size_a, b, size_b))
    rounding = 1e-9
    if not one.intersects(other):
        assert -one.distance(other) - rounding <= depth <= rounding
        return
    # Boxes part along the normal of some side, and a shorter move in any direction is not enough.
    normals = np.array([h + i * np.pi / 2 for h in (a[2], b[2]) for i in range(4)])
    moved = [
        shapely.affinity.translate(other, out * np.cos(turn), out * np.sin(turn))
        for out, turns in ((depth + rounding, normals), (depth - rounding, np.linspace(0, 6.2, 40)))
        for turn in turns
    ]
    assert min(one.intersection(other).area for other in moved[: len(normals)]) <= rounding
    if depth > rounding:
        assert all(one.intersects(other) for other in moved[len(normals) :])
