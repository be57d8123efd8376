"""The adapter from a log's map: lanes, blocks, areas, and the route on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from recast.core.errors import InputError
from recast.geometry import se2
from recast.logs.hdmap import HdMap, Lane
from recast.logs.types import Trajectory
from recast.planning import ReferenceRoute
from recast.planning.map import continued_route, planner_map, route_blocks, with_headings

HALF = 1.75


def lane(key: str, points, successors=(), left=None, right=None, inside=False) -> Lane:
    points = np.array(points, np.float64)
    poses = with_headings(points, 1.0)
    normal = np.stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])], axis=-1)

    def offset(d):
        return np.c_[poses[:, :2] + d * normal, np.zeros(len(poses))]

    outline = np.concatenate([offset(-HALF), offset(HALF)[::-1]])[:, :2]
    centre = np.c_[points, np.zeros(len(points))]
    return Lane(
        key,
        centre,
        offset(HALF),
        offset(-HALF),
        outline,
        10.0,
        tuple(successors),
        left,
        right,
        inside,
    )


def junction() -> HdMap:
    """Two lanes eastwards, a junction with two lanes straight on and a left turn, a way back.

    a, b: in; sa, sb: straight on; t: the left turn, in two parts; c, d: out; n: north; o: the
    oncoming lane.
    """
    turn = [(40 + 12 * np.sin(u), 12 - 12 * np.cos(u)) for u in np.linspace(0, np.pi / 2, 13)]
    lanes = [
        lane("a", [(0, -3.5), (40, -3.5)], ["sa"], left="b"),
        lane("b", [(0, 0), (40, 0)], ["sb", "t"]),  # does not name its neighbour
        lane("sa", [(40, -3.5), (60, -3.5)], ["c"], inside=True),
        lane("sb", [(40, 0), (60, 0)], ["d"], inside=True),
        lane("t", turn[:7], ["u"], inside=True),
        lane("u", turn[6:], ["n"], inside=True),
        lane("c", [(60, -3.5), (100, -3.5)], left="d"),
        lane("d", [(60, 0), (100, 0)], right="c"),
        lane("n", [(52, 12), (52, 60)]),
        lane("o", [(100, 3.5), (0, 3.5)]),
    ]
    area = np.array([[-5, -9], [105, -9], [105, 9], [-5, 9]], np.float64)
    return HdMap({item.lane_id: item for item in lanes}, (area,))


def drive(*points) -> ReferenceRoute:
    poses = with_headings(np.array(points, np.float64), 0.5)
    times = (100_000 * np.arange(len(poses))).astype(np.int64)
    return ReferenceRoute.from_trajectory(Trajectory(times, se2.to_se3(poses)))


def test_centrelines_are_dense_and_turn_smoothly():
    coarse = [(10 * np.cos(u), 10 * np.sin(u)) for u in np.linspace(0, np.pi / 2, 9)]
    poses = with_headings(np.array(coarse))
    steps = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    assert steps.max() <= 0.5
    assert np.abs(np.diff(poses[:, 2])).max() < 0.06
    np.testing.assert_allclose(poses[-1, :2], coarse[-1], atol=1e-12)
    middle = len(poses) // 2
    tangent = np.arctan2(poses[middle, 1], poses[middle, 0]) + np.pi / 2
    assert poses[middle, 2] == pytest.approx(tangent, abs=0.02)


def test_neighbours_share_a_block_and_connectors_that_join_the_same_blocks():
    found = planner_map(junction())
    members = {frozenset(block.lane_ids) for block in found.blocks.values()}
    assert members == {
        frozenset(group) for group in (["a", "b"], ["sa", "sb"], ["t"], ["u"], ["c", "d"], "n", "o")
    }
    block = found.blocks[found.lanes["a"].block_id]
    assert not block.connector
    assert set(block.successors) == {found.lanes["sa"].block_id, found.lanes["t"].block_id}
    straight = found.blocks[found.lanes["sb"].block_id]
    assert straight.connector
    assert straight.predecessors == (block.block_id,)


def test_opposite_parts_of_a_roundabout_are_different_blocks():
    # Four roads in (i) and out (e), four connectors onto the ring (on), off it (off), and eight
    # parts of the ring; positions do not matter for grouping.
    lanes = []
    for k in range(4):
        nxt = (k + 1) % 4
        lanes += [
            lane(f"i{k}", [(0, 0), (9, 0)], [f"on{k}"]),
            lane(f"on{k}", [(0, 0), (9, 0)], [f"far{k}"], inside=True),
            lane(f"far{k}", [(0, 0), (9, 0)], [f"near{nxt}", f"off{nxt}"], inside=True),
            lane(f"near{k}", [(0, 0), (9, 0)], [f"far{k}"], inside=True),
            lane(f"off{k}", [(0, 0), (9, 0)], [f"e{k}"], inside=True),
            lane(f"e{k}", [(0, 0), (9, 0)]),
        ]
    found = planner_map(HdMap({item.lane_id: item for item in lanes}, ()))
    assert all(len(block.lane_ids) == 1 for block in found.blocks.values())


def test_lanes_keep_what_the_log_knows_of_them():
    hdmap = junction()
    found = planner_map(
        replace(hdmap, lanes={**hdmap.lanes, "n": replace(hdmap.lanes["n"], speed_limit=None)})
    )
    assert found.lanes["a"].speed_limit == 10.0
    assert found.lanes["n"].speed_limit is None
    assert found.lanes["b"].successors == ("sb", "t")
    assert found.lanes["a"].length == pytest.approx(40.0)
    assert found.lanes["t"].connector and not found.lanes["n"].connector


def test_where_points_are():
    found = planner_map(junction())
    assert found.lanes_at([20.0, 0.0]) == ("b",)
    assert found.lanes_at([20.0, -1.75]) == ("a", "b")
    assert found.lanes_at([20.0, 6.0]) == ()
    assert found.lanes_at([20.0, 6.0], 1.0) == ("o",)
    points = np.array([[50.0, -3.5], [20.0, 0.0], [20.0, 8.0], [20.0, 12.0]])
    assert found.in_intersection(points).tolist() == [True, False, False, False]
    assert found.drivable_hits(points).tolist() == [True, True, True, False]
    hits = found.lane_hits(points)
    assert hits["b"].tolist() == [False, True, False, False]
    assert "n" not in hits


def test_the_surroundings_hold_whole_polygons():
    near = planner_map(junction()).near([10.0, 0.0], 20.0)
    assert set(near.lanes) == {"a", "b", "o"}
    assert near.lanes["b"].successors == ()
    assert near.drivable_hits(np.array([[100.0, 0.0]])).all()


def test_an_outline_that_crosses_itself_is_taken_apart():
    hdmap = junction()
    bow = np.array([[0, 0], [10, 10], [10, 0], [0, 10]], np.float64)
    found = planner_map(replace(hdmap, drivable_area=(bow,)))
    assert shapely.area(found.drivable[0]) == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("path", "lanes"),
    [
        ([(2, 0), (98, 0)], ["a", "sa", "c"]),
        ([(2, 0), (40, 0), (48.5, 3.5), (52, 12), (52, 50)], ["a", "t", "u", "n"]),
        ([(2, -3.5), (20, -3.5), (60, 0), (98, 0)], ["a", "sa", "c"]),
        ([(98, 3.5), (2, 3.5)], ["o"]),
    ],
)
def test_the_route_is_what_the_log_drove_on(path, lanes):
    found = planner_map(junction())
    wanted = tuple(found.lanes[key].block_id for key in lanes)
    assert route_blocks(found, drive(*path)) == wanted


def test_a_route_goes_straight_on_where_the_log_ends():
    found = planner_map(junction())
    block = {key: lane.block_id for key, lane in found.lanes.items()}
    start = (block["a"],)
    assert continued_route(found, start, 15.0) == (block["a"], block["sa"])
    assert continued_route(found, start, 500.0) == (block["a"], block["sa"], block["c"])
    assert continued_route(found, start, 0.0) == start


def test_a_route_does_not_go_on_where_it_has_been():
    ring = [lane(key, [(0, 0), (9, 0)], [after]) for key, after in ("ab", "bc", "ca")]
    found = planner_map(HdMap({item.lane_id: item for item in ring}, ()))
    assert continued_route(found, ("a",), 500.0) == ("a", "b", "c")


def test_neighbours_belong_to_the_route():
    found = planner_map(junction())
    blocks = route_blocks(found, drive((2, -3.5), (98, -3.5)))
    assert set(found.lanes_of(blocks)) == {"a", "b", "sa", "sb", "c", "d"}


def test_a_route_off_the_map_is_refused():
    with pytest.raises(InputError, match=r"no lane of the map lies within 2\.5 m of the path from"):
        route_blocks(planner_map(junction()), drive((2, 30), (98, 30)))


def test_a_map_without_lanes_is_refused():
    with pytest.raises(InputError, match="lanes: are missing"):
        planner_map(replace(junction(), lanes={}))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("centreline", np.ones((4, 3)), r"lanes\['a'\]\.centreline: has fewer than two"),
        ("polygon", np.array([[0.0, 0], [1, 0], [2, 0]]), r"lanes\['a'\]\.polygon: encloses no"),
    ],
)
def test_degenerate_lanes_are_named(field, value, message):
    hdmap = junction()
    broken = replace(hdmap.lanes["a"], **{field: value})
    with pytest.raises(InputError, match=message):
        planner_map(replace(hdmap, lanes={**hdmap.lanes, "a": broken}))
