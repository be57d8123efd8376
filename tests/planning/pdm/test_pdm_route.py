"""Mending routes, the start lane and the way along the lanes."""

import numpy as np
import pytest
import shapely
from pdm_golden import golden_map

from recast.dynamics import PACIFICA
from recast.planning.map import PlannerLane, PlannerMap
from recast.planning.pdm.forecast import box_centres, outline
from recast.planning.pdm.proposals import repair_route, route_centreline, start_block, start_lane


def chain(names: str, connectors: str = "") -> PlannerMap:
    """Lanes of 10 m one after the other, each its own block named in capitals."""
    lanes = {}
    for i, name in enumerate(names):
        line = np.stack([np.linspace(10.0 * i, 10.0 * i + 10.0, 21), np.zeros(21), np.zeros(21)])
        lanes[name] = PlannerLane(
            name,
            name.upper(),
            line.T,
            shapely.box(10.0 * i, -1.75, 10.0 * i + 10.0, 1.75),
            successors=tuple(names[i + 1 : i + 2]),
            connector=name in connectors,
        )
    return PlannerMap(lanes)


def lane_of(planner_map, lanes, pose):
    pose = np.array(pose)
    return start_lane(
        planner_map, lanes, pose, box_centres(pose, PACIFICA), outline(pose, PACIFICA)
    ).lane_id


@pytest.mark.parametrize(
    ("route", "start", "mended"),
    [
        ("ABC", "A", "ABC"),
        ("AC", "A", "ABC"),
        ("ADF", "A", "ABCDEF"),
        ("DEF", "B", "BCDEF"),
        ("AABB", None, "AB"),
        ("CBA", None, "CBA"),
    ],
)
def test_missing_blocks_are_filled_in(route, start, mended):
    assert "".join(repair_route(chain("abcdef"), list(route), start)) == mended


def test_a_route_that_cannot_be_reached_backwards_is_joined_later():
    # From B one gets to D, the second block of the route, but not to its first one.
    base = chain("abcd")
    lanes = dict(base.lanes)
    lanes["x"] = PlannerLane(
        "x", "X", lanes["a"].centreline, shapely.box(0, 5, 10, 8), None, ("d",)
    )
    assert repair_route(PlannerMap(lanes), ["X", "D"], "B") == ["B", "C", "D"]


def test_a_route_is_cut_where_it_crosses_itself():
    base = chain("abcd", connectors="bd")
    lanes = dict(base.lanes)
    lanes["d"] = PlannerLane(
        "d", "D", lanes["d"].centreline, shapely.box(14, -5, 16, 5), connector=True
    )
    assert repair_route(PlannerMap(lanes), list("ABCD"), "A") == ["A", "B", "C"]


def test_connectors_that_follow_on_each_other_may_overlap():
    base = chain("abcd", connectors="bc")
    lanes = dict(base.lanes)
    lanes["c"] = PlannerLane(
        "c", "C", lanes["c"].centreline, shapely.box(17, -3, 30, 3), None, ("d",), True
    )
    assert repair_route(PlannerMap(lanes), list("ABCD"), "A") == list("ABCD")


def test_the_start_block_prefers_the_route_and_its_direction():
    planner_map = golden_map()
    assert start_block(planner_map, [82.0, 0.0, 0.0], ["R1", "C2", "R3"]) == "C2"
    assert start_block(planner_map, [82.0, 0.0, 0.0], ["R1", "C1", "R2"]) == "C1"
    assert start_block(planner_map, [20.0, -3.5, 0.0], ["R1"]) is None
    assert start_block(planner_map, [20.0, -3.5, np.pi], ["R1"]) == "R9"


def test_the_start_lane_is_under_the_axle_else_the_centre_else_the_nearest():
    planner_map, lanes = golden_map(), golden_map().lanes_of(["R1", "C1", "R2"])
    assert lane_of(planner_map, lanes, [20.0, 3.0, 0.0]) == "B1"
    assert lane_of(planner_map, lanes, [-1.0, 3.0, 0.0]) == "B1"
    assert lane_of(planner_map, lanes, [50.0, -6.0, 0.0]) == "A1"


def test_the_centreline_follows_the_route():
    planner_map = golden_map()
    straight = route_centreline(planner_map, ["R1", "C1", "R2"], planner_map.lanes["A1"])
    left = route_centreline(planner_map, ["R1", "C2", "R3"], planner_map.lanes["A1"])
    assert straight.poses[-1, 0] == 180.0
    np.testing.assert_allclose(left.poses[-1], [100.0, 90.0, np.pi / 2], atol=1e-6)


def test_the_centreline_ends_where_the_route_cannot_be_followed():
    planner_map = golden_map()
    path = route_centreline(planner_map, ["R1", "C2", "R3"], planner_map.lanes["B1"])
    assert path.length == pytest.approx(80.0)
