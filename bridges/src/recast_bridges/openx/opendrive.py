"""OpenDRIVE 1.7 (ASAM) of a map's lanes.

Neighbours of one direction are lanes of one road, the others roads of one lane (`junctions`). The
reference line consists of straight lines and arcs (`reference_line`). It follows the centreline of
the middle lane; lane offset and widths bring the lanes to the map's boundaries. Heights are those
of that centreline. Links that junctions cannot express are left out and counted. Drivable areas
beside the lanes have no place in the format.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np
import shapely

from recast.arrays import Array
from recast.core.files import write_bytes
from recast.logs.checks import WORLD_REACH
from recast.logs.hdmap import FASTEST, HdMap, Lane
from recast_bridges.openx import reference_line
from recast_bridges.openx.junctions import LaneNetwork, network
from recast_bridges.openx.openscenario import XmlFile

_STEP = 0.05
"""Metres between cross sections at which boundaries are written and read: where a lane is slanted
or turns about a corner, they lie further apart at its other side."""
_LEAST_STEPS, _MOST_STEPS = 200, 4000
"""Cross sections of a road; longer roads have longer steps."""
_ROUNDED = 0.001
"""Metres by which a piecewise linear width, offset or height may leave them."""
_GOOD = 0.02
"""Metres from the map's boundaries, either way, up to which no other reference line is tried."""
_LANE_ID = "lane_id"


@dataclass(frozen=True)
class RoadLane:
    """A lane, as a file tells it."""

    lane_id: str  # id of the lane in the map
    # centreline, left_boundary, right_boundary: (N, 3) points, metres.
    centreline: Array
    left_boundary: Array
    right_boundary: Array
    speed_limit: float | None  # speed limit in m/s, or None
    successors: tuple[str, ...]  # lanes that links and junctions name
    # left_neighbour, right_neighbour: lane beside it in its road, or None.
    left_neighbour: str | None
    right_neighbour: str | None


@dataclass(frozen=True)
class LeftOutLinks:
    """What the format cannot express of a map."""

    links: int  # links between lanes, see `junctions`
    neighbours: int  # pairs of neighbours that are not in one road


def write_opendrive(path: str | Path, hdmap: HdMap, name: str) -> LeftOutLinks:
    """Write a map's lanes, whole or not at all.

    Args:
        name: name of the map, for people.

    Raises:
        InputError: the disk refuses.
    """
    root = ET.Element("OpenDRIVE")
    shown = "".join(c if c.isprintable() else "?" for c in name)
    _add(root, "header", revMajor=1, revMinor=7, name=shown, version="1.00")
    links = network(hdmap.lanes)
    place = {key: (i, -1 - j) for i, road in enumerate(links.roads) for j, key in enumerate(road)}
    for number in range(len(links.roads)):
        _road(root, number, hdmap, place, links)
    first = len(links.roads)  # ids of roads and junctions are all different
    for number, connections in links.connections.items():
        junction = _add(root, "junction", name=f"junction-{number}", id=first + number)
        for i, (incoming, connecting) in enumerate(connections):
            ends = {"incomingRoad": incoming, "connectingRoad": connecting}
            connection = _add(junction, "connection", id=i, **ends, contactPoint="start")
            for key in links.roads[incoming]:
                for other in hdmap.lanes[key].successors:
                    if place[other][0] == connecting:
                        pair = {"from": place[key][1], "to": place[other][1]}
                        _add(connection, "laneLink", **pair)
    ET.indent(root)
    data = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    write_bytes(path, data + b"\n")
    return LeftOutLinks(links.left_out, links.parted)


def _add(parent: ET.Element, tag: str, **attributes: object) -> ET.Element:
    return ET.SubElement(parent, tag, {name: str(value) for name, value in attributes.items()})


def _road(
    root: ET.Element,
    number: int,
    hdmap: HdMap,
    place: dict[str, tuple[int, int]],
    links: LaneNetwork,
) -> None:
    keys = links.roads[number]
    lanes = [hdmap.lanes[key] for key in keys]
    boundaries = [lane.right_boundary[:, :2] for lane in lanes]
    boundaries.insert(0, lanes[0].left_boundary[:, :2])
    middle = lanes[len(lanes) // 2].centreline
    pieces, s, beside = _cross_sections(middle[:, :2], boundaries)
    length = float(s[-1])
    inside = links.junction.get(number)
    junction = -1 if inside is None else len(links.roads) + inside
    name = quote(keys[0], safe="")
    road = _add(root, "road", name=name, length=length, id=number, junction=junction)
    link = _add(road, "link")
    ends = (
        ("predecessor", links.before.get(number), "end"),
        ("successor", links.after.get(number), "start"),
    )
    for tag, end, contact in ends:
        if end is not None and end.road is not None:
            what = {"elementType": "road", "elementId": end.road, "contactPoint": contact}
            _add(link, tag, **what)
        elif end is not None and end.junction is not None:
            _add(link, tag, elementType="junction", elementId=len(links.roads) + end.junction)
    _add(road, "type", s=0.0, type="town")
    view = _add(road, "planView")
    starts = np.concatenate([[0.0], np.cumsum(pieces[:-1, 3])])
    for at, (x, y, heading, size, curvature) in zip(starts, pieces.tolist(), strict=True):
        geometry = _add(view, "geometry", s=float(at), x=x, y=y, hdg=heading, length=size)
        if curvature:
            _add(geometry, "arc", curvature=curvature)
        else:
            _add(geometry, "line")
    profile = _add(road, "elevationProfile")
    for row in reference_line.linear(s, _heights(pieces, s, middle), _ROUNDED):
        _add(profile, "elevation", **row)
    _add(road, "lateralProfile")
    section = _add(road, "lanes")
    for row in reference_line.linear(s, beside[0], _ROUNDED):
        _add(section, "laneOffset", **row)
    section = _add(section, "laneSection", s=0.0)
    centre = _add(_add(section, "center"), "lane", id=0, type="none", level="false")
    _add(centre, "link")
    side = _add(section, "right")
    road_links = {tag: end for tag, end, _ in ends if end is not None and end.road is not None}
    before = [key for key, lane in hdmap.lanes.items() if set(lane.successors) & set(keys)]
    for lane, inner, outer in zip(lanes, beside[:-1], beside[1:], strict=True):
        own = _add(side, "lane", id=place[lane.lane_id][1], type="driving", level="false")
        own_link = _add(own, "link")
        others = {
            "predecessor": [key for key in before if lane.lane_id in hdmap.lanes[key].successors],
            "successor": lane.successors,
        }
        for tag, end in road_links.items():
            for key in others[tag]:
                if place[key][0] == end.road:
                    _add(own_link, tag, id=place[key][1])
        widths = np.maximum(inner - outer, 0.0)
        for row in reference_line.linear(s, widths, _ROUNDED, "sOffset"):
            _add(own, "width", **row)
        if lane.speed_limit is not None:
            _add(own, "speed", sOffset=0.0, max=float(lane.speed_limit), unit="m/s")
        _add(own, "userData", code=_LANE_ID, value=quote(lane.lane_id, safe=""))


def _cross_sections(middle: Array, boundaries: list[Array]) -> tuple[Array, Array, list[Array]]:
    """Pieces of a reference line, s (N,) of its cross sections, and at which distance to the left
    (N,) each boundary lies. The line follows the middle; where a lane turns so tightly that normals
    cross within it, an outer boundary."""
    corners = [(boundaries[0][end], boundaries[-1][end]) for end in (0, -1)]
    best, least = None, np.inf
    for line in (middle, boundaries[0], boundaries[-1]):
        pieces = reference_line.between(line, *corners)
        length = float(pieces[:, 3].sum())
        steps = int(np.clip(math.ceil(length / _STEP), _LEAST_STEPS, _MOST_STEPS))
        s = np.linspace(0, length, steps + 1)
        beside = [reference_line.crossings(pieces, s, boundary) for boundary in boundaries]
        points, headings = reference_line.evaluate(pieces, s)
        left = np.stack([-np.sin(headings), np.cos(headings)], axis=1)
        apart = max(
            reference_line.apart(points + t[:, None] * left, boundary)
            for t, boundary in zip(beside, boundaries, strict=True)
        )
        if apart < least:
            best, least = (pieces, s, beside), apart
        if least < _GOOD:
            break
    assert best is not None
    return best


def _heights(pieces: Array, s: Array, line: Array) -> Array:
    """(N,) heights of the points of a polyline (M, 3) that lie nearest to a reference line's."""
    points, _ = reference_line.evaluate(pieces, s)
    along = shapely.line_locate_point(shapely.LineString(line[:, :2]), shapely.points(points))
    lengths = np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1)
    heights: Array = np.interp(along, np.concatenate([[0.0], np.cumsum(lengths)]), line[:, 2])
    return heights


def read_opendrive(path: str | Path) -> dict[str, RoadLane]:
    """The lanes of a file that `write_opendrive` wrote.

    Raises:
        InputError: no such file, see `XmlFile`.
    """
    file = XmlFile(path, "OpenDRIVE")
    roads = {file.text(road, "id"): road for road in file.root.findall("road")}
    names = {
        (number, file.text(lane, "id")): _lane_id(file, lane)
        for number, road in roads.items()
        for lane in road.findall("lanes/laneSection/right/lane")
    }

    def named(road: str, lane: str, where: str) -> str:
        if (road, lane) not in names:
            raise file.fault(where, "names a road or lane that does not exist")
        return names[road, lane]

    successors: dict[str, list[str]] = {key: [] for key in names.values()}
    for junction in file.root.findall("junction"):
        for connection in junction.findall("connection"):
            incoming, connecting = (
                file.text(connection, name) for name in ("incomingRoad", "connectingRoad")
            )
            for pair in connection.findall("laneLink"):
                first = named(incoming, file.text(pair, "from"), "connection")
                other = named(connecting, file.text(pair, "to"), "connection")
                successors[first].append(other)
    found: dict[str, RoadLane] = {}
    for number, road in roads.items():
        after = road.find("link/successor")
        if after is not None and file.text(after, "elementType") == "road":
            other = file.text(after, "elementId")
            for lane in road.findall("lanes/laneSection/right/lane"):
                first = names[number, file.text(lane, "id")]
                for link in lane.findall("link/successor"):
                    successors[first].append(named(other, file.text(link, "id"), "successor"))
        found |= _read_road(file, road, successors)
    return found


def _lane_id(file: XmlFile, lane: ET.Element) -> str:
    for data in lane.findall("userData"):
        if file.text(data, "code") == _LANE_ID:
            return unquote(file.text(data, "value"))
    raise file.fault("lane", f"lacks userData {_LANE_ID}")


def _read_road(
    file: XmlFile, road: ET.Element, successors: dict[str, list[str]]
) -> dict[str, RoadLane]:
    reach = (-WORLD_REACH, WORLD_REACH)

    def rows(parent: ET.Element, way: str, start: str, s: Array) -> Array:
        """Values at s of a profile."""
        entries = parent.findall(way)
        if not entries:
            raise file.fault(parent.tag, f"lacks {way}")
        table = np.array([[file.number(e, n, *reach) for n in (start, *"abcd")] for e in entries])
        row = np.clip(np.searchsorted(table[:, 0], s, "right") - 1, 0, len(table) - 1)
        ds = s - table[row, 0]
        values: Array = sum(table[row, 1 + power] * ds**power for power in range(4))
        return values

    table = []
    for geometry in road.findall("planView/geometry"):
        row = [file.number(geometry, name, *reach) for name in ("x", "y", "hdg")]
        row.append(file.number(geometry, "length", 0, WORLD_REACH))
        arc = geometry.find("arc")
        if arc is None:
            file.one(geometry, "line")
        table.append([*row, 0.0 if arc is None else file.number(arc, "curvature", *reach)])
    if not table:
        raise file.fault("road", "has no geometry")
    pieces = np.array(table)
    length = float(pieces[:, 3].sum())
    steps = int(np.clip(math.ceil(length / _STEP), _LEAST_STEPS, _MOST_STEPS))
    s = np.union1d(np.linspace(0, length, steps + 1), np.cumsum(pieces[:-1, 3]))
    points, headings = reference_line.evaluate(pieces, s)
    normals = np.stack([-np.sin(headings), np.cos(headings)], axis=1)
    heights = rows(road, "elevationProfile/elevation", "s", s)
    inner = rows(road, "lanes/laneOffset", "s", s)

    def line(t: Array) -> Array:
        return np.column_stack([points + t[:, None] * normals, heights])

    entries = road.findall("lanes/laneSection/right/lane")
    keys = [_lane_id(file, entry) for entry in entries]
    found = {}
    for i, (key, entry) in enumerate(zip(keys, entries, strict=True)):
        outer = inner - rows(entry, "width", "sOffset", s)
        speed = entry.find("speed")
        found[key] = RoadLane(
            lane_id=key,
            centreline=line((inner + outer) / 2),
            left_boundary=line(inner),
            right_boundary=line(outer),
            speed_limit=None if speed is None else file.number(speed, "max", 0, FASTEST),
            successors=tuple(successors[key]),
            left_neighbour=keys[i - 1] if i else None,
            right_neighbour=keys[i + 1] if i + 1 < len(keys) else None,
        )
        inner = outer
    return found


def lane_differences(lane: Lane, other: RoadLane) -> tuple[float, float]:
    """Largest distances in plan, either way, of a lane's boundaries and of its centreline from
    those that a file tells, metres."""

    boundaries = (
        reference_line.apart(getattr(lane, side)[:, :2], getattr(other, side)[:, :2])
        for side in ("left_boundary", "right_boundary")
    )
    centrelines = reference_line.apart(lane.centreline[:, :2], other.centreline[:, :2])
    return max(boundaries), centrelines
