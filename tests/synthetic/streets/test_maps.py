"""The maps of all kinds of street."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely

from recast.geometry import Polyline, se2
from recast.logs.hdmap import drivable_region, read_map, write_map
from recast.synthetic.streets import EGO_START, SCENES
from synthetic.streets.built import LENGTH, built

ONE_LANE_KINDS = (
    "suburban-curve",
    "rural-two-lane",
    "parked-street",
    "roundabout-approach",
    "industrial",
)


def route_line(name: str) -> Polyline:
    street = built(name)
    lanes = [street.map.lanes[lane_id].centreline for lane_id in street.ego_route]
    return Polyline.from_points(np.concatenate(lanes), min_step=1e-3)


@pytest.mark.parametrize("name", SCENES)
class TestEveryKind:
    def test_map_is_valid(self, name: str) -> None:
        built(name).map.validate()

    def test_successors_meet(self, name: str) -> None:
        lanes = built(name).map.lanes
        for lane in lanes.values():
            for other in lane.successors:
                for line in ("centreline", "left_boundary", "right_boundary"):
                    gap = getattr(lanes[other], line)[0] - getattr(lane, line)[-1]
                    assert np.linalg.norm(gap) < 0.01, (lane.lane_id, other, line)

    def test_route_follows_successors(self, name: str) -> None:
        street = built(name)
        for here, ahead in zip(street.ego_route[:-1], street.ego_route[1:], strict=True):
            assert ahead in street.map.lanes[here].successors

    def test_route_is_long_and_smooth(self, name: str) -> None:
        line = route_line(name)
        assert line.length >= EGO_START + LENGTH + 120.0
        s = np.arange(0.0, line.length, 0.5)
        turn = np.abs(se2.wrap_angle(np.diff(line.heading(s))))
        assert turn.max() < 0.25  # no corner; the tightest turn has a radius of about 6 m
        assert abs(line.heading(EGO_START)) < 0.3  # the drive begins about along x

    def test_lanes_lie_in_the_drivable_area(self, name: str) -> None:
        street = built(name)
        area = shapely.union_all([shapely.Polygon(o) for o in street.map.drivable_area])
        for lane in street.map.lanes.values():
            assert shapely.Polygon(lane.polygon).difference(area.buffer(0.01)).area < 0.02

    def test_drivable_area_is_the_asphalt_without_islands(self, name: str) -> None:
        street = built(name)
        region = drivable_region(street.map)
        assert region is not None and region.is_valid
        pieces = [shapely.Polygon(o) for o in street.map.drivable_area]
        assert all(piece.is_valid and piece.exterior.is_ccw for piece in pieces)
        assert sum(piece.area for piece in pieces) == pytest.approx(region.area, rel=1e-3)

    def test_left_is_left_and_polygons_turn_left(self, name: str) -> None:
        for lane in built(name).map.lanes.values():
            assert shapely.Polygon(lane.polygon).exterior.is_ccw, lane.lane_id
            along = np.gradient(lane.centreline[:, :2], axis=0)
            across = (lane.left_boundary - lane.right_boundary)[:, :2]
            assert np.all(along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0] > 0)
            width = np.linalg.norm(across, axis=1)
            assert width.min() > 3.0 and width.max() < 4.0, lane.lane_id

    def test_neighbours_are_mutual_and_beside(self, name: str) -> None:
        lanes = built(name).map.lanes
        for lane in lanes.values():
            if lane.left_neighbour is not None:
                other = lanes[lane.left_neighbour]
                assert other.right_neighbour == lane.lane_id
                np.testing.assert_allclose(lane.left_boundary, other.right_boundary, atol=0.02)
            if lane.right_neighbour is not None:
                assert lanes[lane.right_neighbour].left_neighbour == lane.lane_id

    def test_a_lane_beside_the_ego(self, name: str) -> None:
        """Of its direction where the kind has one; always some lane 3.5 m to the left."""
        street, line = built(name), route_line(name)
        lanes_driven = [street.map.lanes[lane_id] for lane_id in street.ego_route]
        neighbours = [k for k in lanes_driven if k.left_neighbour or k.right_neighbour]
        assert bool(neighbours) == (name not in ONE_LANE_KINDS)
        s = np.arange(EGO_START, EGO_START + 16.0, 1.0)
        beside = shapely.points(line.to_cartesian(s, 3.5))
        lanes = shapely.union_all([shapely.Polygon(k.polygon) for k in street.map.lanes.values()])
        assert shapely.covers(lanes, beside).all()

    def test_speed_limits(self, name: str) -> None:
        limits = [lane.speed_limit for lane in built(name).map.lanes.values()]
        assert all(limit is not None and 5.0 <= limit <= 30.0 for limit in limits)

    def test_ground_is_level_on_the_road(self, name: str) -> None:
        street = built(name)
        assert street.map.ground is not None
        for lane in street.map.lanes.values():
            for line in (lane.centreline, lane.left_boundary, lane.right_boundary):
                np.testing.assert_array_equal(street.map.ground.at(line[:, :2]), 0.0)


def test_junction_lanes_are_marked() -> None:
    lanes = built("signalled-intersection").map.lanes
    inside = [key for key, lane in lanes.items() if lane.is_intersection]
    assert all(key.startswith("crossing") for key in inside)
    assert len(inside) == 4 * 4  # each arm: two lanes straight on, one left, one right


def test_ego_turns_at_the_signals_and_goes_round_the_ring() -> None:
    line = route_line("signalled-intersection")
    turn = abs(float(line.heading(line.length - 1) - line.heading(1.0)))
    assert turn == pytest.approx(np.pi / 2, abs=0.05)
    assert sum(key.startswith("ring") for key in built("roundabout-approach").ego_route) == 3


def test_map_survives_its_file(tmp_path: Path) -> None:
    street_map = built("roundabout-approach").map
    write_map(street_map, tmp_path / "map.json")
    again = read_map(tmp_path / "map.json")
    assert again.lanes.keys() == street_map.lanes.keys()
    for key, lane in street_map.lanes.items():
        np.testing.assert_array_equal(again.lanes[key].polygon, lane.polygon)
        assert again.lanes[key].successors == lane.successors
    for one, other in zip(again.drivable_area, street_map.drivable_area, strict=True):
        np.testing.assert_array_equal(one, other)
