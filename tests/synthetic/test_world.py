from __future__ import annotations

import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st

from recast.geometry import boxes
from recast.synthetic.world import hiding, touching

places = st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-4, 4))
sizes = st.tuples(st.floats(0.5, 8), st.floats(0.5, 4))


def polygon(pose: tuple[float, ...], size: tuple[float, ...]) -> shapely.Polygon:
    return shapely.Polygon(boxes.bev_corners(np.array(pose), *size))


@given(places, sizes, places, sizes)
def test_touching_is_what_shapely_says(a, size_a, b, size_b) -> None:
    first, second = polygon(a, size_a), polygon(b, size_b)
    expected = first.intersects(second)
    if expected and first.intersection(second).area < 1e-6:
        return
    assert touching(np.array([a]), size_a, np.array([b]), size_b)[0] == expected


def test_the_margin_is_the_gap_kept() -> None:
    a, b = np.array([[0.0, 0.0, 0.0]]), np.array([[6.0, 0.0, 0.0]])
    assert not touching(a, (4, 2), b, (4, 2), margin=1.9)[0]
    assert touching(a, (4, 2), b, (4, 2), margin=2.1)[0]


@given(places, sizes, places, sizes)
def test_hiding_is_a_sight_line_that_is_cut(target, size, other, other_size) -> None:
    eye = np.array([-20.0, 0.5])
    shape = polygon(other, other_size)
    ends = [*boxes.bev_corners(np.array(target), *size), np.array(target[:2])]
    lines = [shapely.LineString([eye, end]) for end in ends]
    clear = all(not line.intersects(shape.buffer(1e-6)) for line in lines)
    cut = any(line.intersects(shape.buffer(-1e-6)) for line in lines)
    found = bool(hiding(eye[None], np.array([target]), size, np.array([other]), other_size)[0])
    assert found or not cut
    assert not found or not clear
