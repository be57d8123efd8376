"""Reference lines, roads, the lane graph, triangles and placement."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.synthetic.streets.network import JunctionArm, StreetNetwork
from recast.synthetic.streets.road import Road, Section
from recast.synthetic.streets.shapes import (
    GRASS,
    PAVING,
    Band,
    Decals,
    Edge,
    Ground,
    Pose,
    ReferenceLine,
    flat,
    triangulate,
    without_holes,
)
from recast.synthetic.streets.site import Placer, Prop
from recast.synthetic.surface import Surface

angles = st.floats(-3.0, 3.0)


def straight_road(name: str = "a", length: float = 100.0, **options: object) -> Road:
    line = ReferenceLine.straight(Pose(0.0, 0.0, 0.0), length)
    section = Section(2, 1, lane_width=3.5, parking_right=2.0, edge=0.5)
    return Road(name, line, section, 0.0, length, 10.0, (0.0, length), **options)  # type: ignore[arg-type]


class TestReferenceLine:
    @given(angles, st.floats(-1 / 40, 1 / 40), st.floats(-1 / 40, 1 / 40))
    @settings(max_examples=20, deadline=None)
    def test_headings_are_tangents(self, heading: float, first: float, second: float) -> None:
        line = ReferenceLine.from_bends(Pose(1.0, 2.0, heading), [(40.0, first), (30.0, second)])
        assert line.length == pytest.approx(70.0)
        steps = np.diff(line.points, axis=0)
        middle = (line.headings[1:] + line.headings[:-1]) / 2
        np.testing.assert_allclose(
            steps, np.stack([np.cos(middle), np.sin(middle)], 1) * 0.25, atol=1e-4
        )
        total = line.headings[-1] - line.headings[0]
        assert total == pytest.approx(40 * first + 30 * second, abs=12 * abs(first - second) + 1e-6)

    @given(st.floats(0.5, 2.2), st.booleans())
    @settings(max_examples=20, deadline=None)
    def test_corner_keeps_both_ends(self, turn: float, left: bool) -> None:
        turn = turn if left else -turn
        start = Pose(0.0, 0.0, 0.0)
        end = Pose(12 + 12 * np.cos(turn), 12 * np.sin(turn), turn)
        line = ReferenceLine.between(start, end)
        np.testing.assert_allclose(line.points[[0, -1]], [start[:2], end[:2]], atol=1e-9)
        np.testing.assert_allclose(line.headings[[0, -1]], [0.0, turn], atol=0.02)

    def test_offset_goes_on_straight(self) -> None:
        line = ReferenceLine.circle((0.0, 0.0), 10.0, 0.0, np.pi / 2)
        np.testing.assert_allclose(line.offset(line.length, 0.0), [0.0, 10.0], atol=1e-3)
        np.testing.assert_allclose(line.offset(line.length + 5, 2.0), [-5.0, 8.0], atol=1e-3)

    def test_part_counts_from_zero(self) -> None:
        line = ReferenceLine.from_bends(Pose(0, 0, 0), [(50.0, 0.0), (50.0, 0.02)])
        part = line.part(30.0, 80.0)
        assert part.length == 50.0
        np.testing.assert_allclose(part.offset(20.0, 1.0), line.offset(50.0, 1.0), atol=1e-3)


class TestRoad:
    def test_section_from_the_middle_outwards(self) -> None:
        section = Section(2, 1, lane_width=3.5, median=2.0, parking_right=2.0, edge=0.5)
        assert section.lane(1) == (-1.0, -4.5)
        assert section.lane(2) == (-4.5, -8.0)
        assert section.lane(-1) == (1.0, 4.5)
        assert section.kerb(-1) == -10.5 and section.kerb(1) == 5.0

    def test_lanes_are_chained_and_backward_ones_come_back(self) -> None:
        lanes = {lane.lane_id: lane for lane in straight_road().lanes()}
        assert lanes["a-00-f2"].successors == ("a-01-f2",) and lanes["a-01-f2"].successors == ()
        assert lanes["a-01-b1"].successors == ("a-00-b1",)
        assert lanes["a-00-f1"].right_neighbour == "a-00-f2"
        assert lanes["a-00-f1"].left_neighbour is None
        np.testing.assert_allclose(lanes["a-00-f2"].centreline[0], [0.0, -5.25, 0.0])
        np.testing.assert_allclose(lanes["a-01-b1"].centreline[0], [100.0, 1.75, 0.0], atol=1e-9)

    def test_spread_moves_both_directions_apart(self) -> None:
        road = straight_road(spread=((20.0, 0.0), (40.0, 1.5), (100.0, 1.5)))
        np.testing.assert_allclose(road.point(60.0, -3.0), [60.0, -4.5])
        np.testing.assert_allclose(road.point(60.0, 0.0, side=1), [60.0, 1.5])
        np.testing.assert_allclose(road.point(60.0, 0.0), [60.0, 0.0])
        np.testing.assert_allclose(road.point(10.0, 3.0), [10.0, 3.0])


def crossroads(barred: tuple[tuple[str, str], ...] = ()) -> StreetNetwork:
    section = Section(2, 2, lane_width=3.4)
    arms = []
    for name, heading in (("east", 0.0), ("north", np.pi / 2), ("west", np.pi)):
        line = ReferenceLine.straight(Pose(0.0, 0.0, heading), 80.0)
        arms.append(JunctionArm(Road(name, line, section, 16.0, 80.0, 14.0, (0.0, 80.0)), False))
    network = StreetNetwork([arm.road for arm in arms])
    network.junction("x", arms, 10.0, barred)
    return network


class TestNetwork:
    def test_turns(self) -> None:
        lanes = crossroads().lanes
        # Coming from the west, north is to the left: the inner lane turns there.
        assert "x-west-north-left" in lanes["west-00-b1"].successors
        assert lanes["x-west-north-left"].successors == ("north-00-f1",)
        assert "x-north-west-right" in lanes["north-00-b2"].successors
        assert lanes["x-west-east-1"].right_neighbour == "x-west-east-2"
        assert lanes["x-west-east-1"].is_intersection

    def test_barred_turns_are_missing(self) -> None:
        network = crossroads((("west", "north"),))
        assert not any("west-north" in key for key in network.lanes)
        with pytest.raises(ValueError, match="no way"):
            network.route("west-00-b1", "north-00-f1")

    def test_route(self) -> None:
        assert crossroads().route("west-00-b1", "north-00-f1") == (
            "west-00-b1",
            "x-west-north-left",
            "north-00-f1",
        )


class TestTriangles:
    @given(st.integers(0, 10_000))
    @settings(max_examples=20, deadline=None)
    def test_fill_polygons_with_holes(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        region = shapely.Point(0, 0).buffer(10.0)
        for x, y, r in rng.uniform([-8, -8, 0.5], [8, 8, 4.0], (4, 3)):
            region = region.difference(shapely.Point(x, y).buffer(r))
        corners = triangulate(region)
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
        assert np.all(area >= 0) and area.sum() == pytest.approx(region.area)
        pieces = without_holes(region)
        assert all(len(piece.interiors) == 0 for piece in pieces)
        assert sum(piece.area for piece in pieces) == pytest.approx(region.area)

    def test_flat_looks_up(self) -> None:
        made = flat(shapely.box(0, 0, 2, 3), 0.5, (0.1, 0.2, 0.3), "grass")
        made.validate()
        np.testing.assert_allclose(made.normals[..., 2], 1.0)
        np.testing.assert_allclose(made.vertices[:, 2], 0.5)

    def test_no_decals(self) -> None:
        assert len(Decals().surface()) == 0


EDGE = Edge(True, (Band(3.0, PAVING),), GRASS)


def ground() -> Ground:
    return Ground.make([shapely.box(0, -5, 100, 5)], (), EDGE, (0.1, 0.1, 0.1), 5.0)


def box_prop(size: float, low: float, high: float) -> Prop:
    corners = [[x, y, z] for z in (low, high) for x, y in ((0, 0), (size, 0), (size, size))]
    return Prop.of(Surface.make(corners, [[0, 1, 2], [3, 4, 5]], (0.5, 0.5, 0.5), "matte"))


class TestPlacement:
    def test_keeps_off_the_road_and_off_others(self) -> None:
        lanes = shapely.box(0, -3.5, 100, 3.5)
        placer = Placer(ground(), lanes)
        post = box_prop(1.0, 0.0, 2.0)
        assert not placer.place(post, Pose(50.0, 4.5, 0.0))
        assert placer.place(post, Pose(50.0, 5.5, 0.0))
        assert not placer.place(post, Pose(50.3, 5.6, 0.0))
        assert placer.place(post, Pose(52.0, 5.5, 0.0))
        assert placer.placed[0].vertices[:, 2].min() == pytest.approx(0.12)

    def test_crowns_may_reach_over_the_edge_but_not_the_lanes(self) -> None:
        placer = Placer(ground(), shapely.box(0, -3.5, 100, 3.5))
        crown, arm = box_prop(1.0, 3.0, 4.0), box_prop(1.0, 6.0, 7.0)
        assert placer.place(crown, Pose(50.0, 4.0, 0.0))
        assert not placer.place(crown, Pose(60.0, 2.0, 0.0))
        assert placer.place(arm, Pose(60.0, 2.0, 0.0))

    def test_heights(self) -> None:
        points = np.array([[50.0, 0.0], [50.0, 6.0], [50.0, 100.0]])
        np.testing.assert_allclose(ground().height(points), [0.0, 0.12, 0.12])
        # The cell that the kerb lies in is road, so that no car on the road is lifted.
        np.testing.assert_array_equal(
            ground().grid().at(np.array([[50.0, 5.0], [50.5, -4.9]])), 0.0
        )
        assert ground().grid().at(np.array([50.0, 7.5])) == pytest.approx(0.12)
