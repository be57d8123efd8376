"""OpenDRIVE: lines and arcs alone, lanes where the map has them, links and neighbours."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
import shapely

from recast.arrays import Array
from recast.core.errors import InputError
from recast.logs.hdmap import HdMap, Lane
from recast.logs.importers.argoverse2 import find_map, read_map
from recast.synthetic.streets import make_street
from recast_bridges.openx import read_opendrive, write_opendrive
from recast_bridges.openx.opendrive import LeftOutLinks
from support.road_lanes import lane, outlined

REACH = 0.05
"""Metres between a lane in the file and in the map."""


@dataclass
class Sampled:
    """A lane of a file, evaluated by this module alone."""

    centre: Array
    left: Array
    right: Array
    heights: Array


def polynomial(rows: list[ET.Element], start: str, s: Array) -> Array:
    """Values of piecewise cubics at s."""
    table = np.array([[float(row.get(name, "")) for name in (start, *"abcd")] for row in rows])
    assert table[0, 0] == 0 and np.all(np.diff(table[:, 0]) > 0)
    at = np.searchsorted(table[:, 0], s + 1e-12, "right") - 1
    values: Array = sum(table[at, 1 + i] * (s - table[at, 0]) ** i for i in range(4))
    return values


def sampled(root: ET.Element, step: float = 0.25) -> dict[str, Sampled]:
    """All lanes of a file; headings are summed up in small steps, to be independent of the code."""
    lanes = {}
    for road in root.findall("road"):
        s, points, headings, end = [], [], [], None
        for geometry in road.findall("planView/geometry"):
            (shape,) = geometry
            assert shape.tag in ("line", "arc")
            at, x, y, hdg, length = (
                float(geometry.get(name, "")) for name in ("s", "x", "y", "hdg", "length")
            )
            curvature = float(shape.get("curvature", "0"))
            assert (shape.tag == "arc") == (curvature != 0) and length > 0
            if end is not None:  # position and heading go on
                assert np.allclose([at, x, y], end[:3], 0, 1e-6)
                assert abs((hdg - end[3] + np.pi) % (2 * np.pi) - np.pi) < 1e-6
            count = max(int(np.ceil(length / step)), 2)
            along = np.linspace(0, length, count + 1)
            middle = hdg + curvature * (along[1:] + along[:-1]) / 2
            chord = length / count * np.sinc(curvature * length / count / 2 / np.pi)
            steps = chord * np.stack([np.cos(middle), np.sin(middle)], axis=1)
            line = np.array([x, y]) + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
            s.append(at + along)
            points.append(line)
            headings.append(hdg + curvature * along)
            end = (at + length, *line[-1], headings[-1][-1])
        assert end is not None and float(road.get("length", "")) == pytest.approx(end[0])
        where, line, heading = np.concatenate(s), np.concatenate(points), np.concatenate(headings)
        normal = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        inner = polynomial(road.findall("lanes/laneOffset"), "s", where)
        heights = polynomial(road.findall("elevationProfile/elevation"), "s", where)
        for own in road.findall("lanes/laneSection/right/lane"):
            width = polynomial(own.findall("width"), "sOffset", where)
            assert width.min() >= 0
            sides = [line + t[:, None] * normal for t in (inner - width / 2, inner, inner - width)]
            lanes[lane_id(own)] = Sampled(*sides, heights)
            inner = inner - width
    return lanes


def lane_id(element: ET.Element) -> str:
    (data,) = element.findall("userData[@code='lane_id']")
    return unquote(data.get("value", ""))


def apart(one: Array, other: Array) -> float:
    """Largest distance between two lines in plan, either way."""
    lines = [shapely.LineString(line[:, :2]) for line in (one, other)]
    ways = ((lines[0], other), (lines[1], one))
    return max(
        float(shapely.distance(line, shapely.points(points[:, :2])).max()) for line, points in ways
    )


def boundaries_apart(own: Lane, found: Sampled) -> float:
    return max(apart(own.left_boundary, found.left), apart(own.right_boundary, found.right))


def written(hdmap: HdMap, folder: Path) -> tuple[ET.Element, LeftOutLinks]:
    left_out = write_opendrive(folder / "a.xodr", hdmap, "map")
    return ET.parse(folder / "a.xodr").getroot(), left_out


@pytest.mark.parametrize(
    "scene",
    [
        "suburban-curve",
        "signalled-intersection",
        "rural-two-lane",
        "arterial-median",
        "roundabout-approach",
    ],
)
def test_streets_of_lines_and_arcs(scene: str, tmp_path: Path) -> None:
    hdmap = make_street(scene, np.random.default_rng(1), 30.0).map
    root, left_out = written(hdmap, tmp_path)
    lanes, back = sampled(root), read_opendrive(tmp_path / "a.xodr")
    assert left_out == LeftOutLinks(0, 0) and set(lanes) == set(back) == set(hdmap.lanes)
    for key, own in hdmap.lanes.items():
        found, read = lanes[key], back[key]
        assert boundaries_apart(own, found) < REACH
        assert apart(own.centreline, found.centre) < REACH
        assert apart(read.centreline, found.centre) < REACH
        assert np.abs(found.heights[[0, -1]] - own.centreline[[0, -1], 2]).max() < REACH
        assert set(read.successors) == set(own.successors)
        assert read.left_neighbour == own.left_neighbour
        assert read.right_neighbour == own.right_neighbour
        assert read.speed_limit == own.speed_limit
        for other in own.successors:
            for side in ("left", "right"):
                gap = getattr(found, side)[-1] - getattr(lanes[other], side)[0]
                assert np.linalg.norm(gap) < 0.01  # ASAM's limit


@pytest.fixture(scope="module")
def argoverse2(shared: Path) -> dict[str, HdMap]:
    """Maps of the logs, around the first point of their first lane."""
    logs = sorted((shared / "data" / "argoverse2" / "val").iterdir())
    return {log.name: read_map_anywhere(log) for log in logs}


def read_map_anywhere(log: Path) -> HdMap:
    lanes = json.loads(find_map(log).read_text())["lane_segments"].values()
    points = np.array(
        [[p[axis] for axis in "xyz"] for one in lanes for p in one["left_lane_boundary"]]
    )
    return read_map(log, points[:, :2] - points[0, :2], points[0])


def test_surveyed_lanes(argoverse2: dict[str, HdMap], tmp_path: Path) -> None:
    """Lanes of Argoverse 2 end along slanted lines, by up to 77 degrees."""
    for hdmap in argoverse2.values():
        root, left_out = written(hdmap, tmp_path)
        lanes = sampled(root, 0.02)  # tight turns have their points apart on the outer side
        assert set(lanes) == set(hdmap.lanes)
        far = [key for key, own in hdmap.lanes.items() if boundaries_apart(own, lanes[key]) > REACH]
        assert not far
        back = read_opendrive(tmp_path / "a.xodr")
        kept = sum(len(one.successors) for one in back.values())
        assert kept + left_out.links == sum(len(one.successors) for one in hdmap.lanes.values())


@pytest.fixture(scope="module")
def hdmap() -> HdMap:
    """One lane into another, which parts into two, of which one joins a third."""
    lanes = [
        lane("a/1", 0.0, (0, 0, 0.3), successors=("b&2",)),
        lane("b&2", 0.6, (28.66, 8.87, 0.3), successors=("c", "d")),
        lane("c", 0.5, (50, 30, 0.9), successors=("f",)),
        lane("d", -0.5, (50, 30, 0.9)),
        lane("e", 0.5, (90, 30, 0.9), successors=("f",)),
        lane("f", 0.0, (70, 55, 0.9)),
        lane("g", 0.0, (120, 30, 0.9), successors=("e",)),
    ]
    return HdMap({one.lane_id: one for one in lanes}, ())


def test_lanes_come_back(hdmap: HdMap, tmp_path: Path) -> None:
    root, left_out = written(hdmap, tmp_path)
    back, lanes = read_opendrive(tmp_path / "a.xodr"), sampled(root)
    assert left_out == LeftOutLinks(0, 0) and list(back) == list(hdmap.lanes)
    for key, own in hdmap.lanes.items():
        assert back[key].successors == own.successors
        assert back[key].speed_limit == own.speed_limit
        assert boundaries_apart(own, lanes[key]) < REACH
        assert np.allclose(np.interp(0.5, [0, 1], lanes[key].heights[[0, -1]]), 3.75, 0, 0.02)


def test_lanes_that_part_and_join_lie_in_a_junction(hdmap: HdMap, tmp_path: Path) -> None:
    root, _ = written(hdmap, tmp_path)
    (junction,) = root.findall("junction")
    number = junction.get("id")
    roads = {road.get("id"): road for road in root.findall("road")}
    inside = {road.get("name") for road in roads.values() if road.get("junction") == number}
    assert inside == {"c", "d", "e"} and number not in roads
    pairs = {(one.get("incomingRoad"), one.get("connectingRoad")) for one in junction}
    assert pairs == {("1", "2"), ("1", "3"), ("6", "4")}
    for name, tag in (("b%262", "successor"), ("g", "successor"), ("f", "predecessor")):
        link = root.find(f"road[@name='{name}']/link/{tag}")
        assert link is not None and link.get("elementId") == number


def test_what_parts_and_joins_at_once_is_left_out(hdmap: HdMap, tmp_path: Path) -> None:
    """A lane of a junction that parts again itself is an ordinary road."""
    lanes = dict(hdmap.lanes)
    lanes["c"] = replace(lanes["c"], successors=("f", "h"))
    lanes["h"] = lane("h", 0.0, (70, 80, 0.9))
    _, left_out = written(HdMap(lanes, ()), tmp_path)
    back = read_opendrive(tmp_path / "a.xodr")
    kept = sum(len(one.successors) for one in back.values())
    assert left_out.links > 0
    assert kept + left_out.links == sum(len(o.successors) for o in lanes.values())
    assert all(set(one.successors) <= set(lanes[key].successors) for key, one in back.items())


def flat(*points: tuple[float, float]) -> Array:
    return np.column_stack([np.array(points, float), np.zeros(len(points))])


def strip(
    name: str, low: float, high: float, start: float = 0.0, length: float = 20.0, **links: Any
) -> Lane:
    """A straight lane from y `high` to y `low`."""
    lines = [
        flat(*((x, y) for x in np.linspace(start, start + length, 6)))
        for y in ((low + high) / 2, high, low)
    ]
    return outlined(name, *lines, **links)


def test_neighbours_are_lanes_of_one_road(tmp_path: Path) -> None:
    lanes = [
        strip("r", -7, -3.5, left_neighbour="m", successors=("r2",)),
        strip("m", -3.5, 0, left_neighbour="l", right_neighbour="r", successors=("m2", "l2")),
        strip("l", 0, 3, right_neighbour="m"),
        strip("r2", -7, -3.5, 20, left_neighbour="m2"),
        strip("m2", -3.5, 0, 20, right_neighbour="r2"),
        strip("l2", 0, 3, 20),
        strip("far", -20, -17, left_neighbour="r2"),  # tells a neighbour that it does not touch
    ]
    root, left_out = written(HdMap({one.lane_id: one for one in lanes}, ()), tmp_path)
    rows = [
        [(lane_id(own), own.get("id")) for own in road.findall("lanes/laneSection/right/lane")]
        for road in root.findall("road")
    ]
    assert rows[0] == [("l", "-1"), ("m", "-2"), ("r", "-3")]
    assert rows[1] == [("m2", "-1"), ("r2", "-2")]
    assert [len(row) for row in rows] == [3, 2, 1, 1] and left_out == LeftOutLinks(0, 0)
    back = read_opendrive(tmp_path / "a.xodr")
    assert back["r"].successors == ("r2",) and set(back["m"].successors) == {"m2", "l2"}
    assert back["m"].left_neighbour == "l" and back["m"].right_neighbour == "r"
    assert back["far"].left_neighbour is None


ARC = np.linspace(0, 3 * np.pi / 2, 40)
DEGENERATE = {
    "very short": strip("a", -1.5, 1.5, length=0.02),
    "repeated points": outlined(
        "a",
        flat((0, 0), (0, 0), (5, 0), (5, 0), (5, 0.0001), (10, 0)),
        flat((0, 2), (0, 2), (10, 2), (10, 2)),
        flat((0, -2), (10, -2), (10, -2)),
    ),
    "a cusp": outlined(
        "a",
        flat((0, 0), (5, 0), (4.9, 0), (10, 0)),
        flat((0, 2), (5, 2), (4.95, 2), (10, 2)),
        flat((0, -2), (10, -2)),
    ),
    "no width": outlined("a", flat((0, 0), (10, 0)), flat((0, 0), (10, 0)), flat((0, 0), (10, 0))),
    "a width that begins with none": outlined(
        "a", flat((0, 0), (20, -1.75)), flat((0, 0), (20, 0)), flat((0, 0), (20, -3.5))
    ),
    "slanted alike at both ends": outlined(
        "a", flat((1, 0), (21, 0)), flat((0, 2), (20, 2)), flat((2, -2), (22, -2))
    ),
    "slanted and short": outlined(
        "a", flat((1.5, 0), (4.5, 0)), flat((0, 2), (3, 2)), flat((3, -2), (6, -2))
    ),
    "slanted apart": outlined(
        "a", flat((0, 0), (20, 0)), flat((2, 2), (18, 2)), flat((-2, -2), (22, -2))
    ),
    "right angle": outlined(
        "a",
        flat((0, 0), (10, 0), (10, 10)),
        flat((0, 2), (8, 2), (8, 10)),
        flat((0, -2), (12, -2), (12, 10)),
    ),
    "most of a circle": outlined(
        "a",
        *(np.column_stack([r * np.cos(ARC), r * np.sin(ARC), 0 * ARC]) for r in (10, 8, 12)),
    ),
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_lanes(name: str, tmp_path: Path) -> None:
    own = DEGENERATE[name]
    root, _ = written(HdMap({"a": own}, ()), tmp_path)
    found = sampled(root, 0.02)["a"]
    reach = 0.1 if name == "a cusp" else REACH  # its boundary turns back by 0.05 m
    assert boundaries_apart(own, found) < reach
    length = shapely.LineString(own.centreline[:, :2]).length
    assert shapely.LineString(found.centre).length < 1.3 * length + 0.1
    assert set(read_opendrive(tmp_path / "a.xodr")) == {"a"}


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("<line />", "<spiral />", "lacks line"),
        ('code="lane_id"', 'code="other"', "lacks userData lane_id"),
        ('elementId="1"', 'elementId="77"', "does not exist"),
        ('incomingRoad="1"', 'incomingRoad="77"', "does not exist"),
        ("laneOffset", "other", "lacks lanes/laneOffset"),
        ('hdg="', 'hdg="nan', "hdg"),
    ],
)
def test_broken_roads(hdmap: HdMap, tmp_path: Path, old: str, new: str, line: str) -> None:
    write_opendrive(tmp_path / "a.xodr", hdmap, "map")
    text = (tmp_path / "a.xodr").read_text()
    assert old in text
    (tmp_path / "b.xodr").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=line):
        read_opendrive(tmp_path / "b.xodr")
