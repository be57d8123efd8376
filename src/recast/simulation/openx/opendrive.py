"""OpenDRIVE 1.7 (ASAM) of a map's lanes: one road a lane.

The reference line is the lane's centreline: a cubic between each two of its points, with the same
direction on both sides of a point (Catmull-Rom). Heights and widths change linearly between points.
Where lanes part or join, there is a junction (`junctions`); links that it cannot tell are left out
and counted. Neighbours lie beside each other, but are not told: they would have to be lanes of one
road. Drivable areas beside the lanes have no place in the format.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np

from recast.arrays import Array
from recast.core.files import write_bytes
from recast.logs.checks import WORLD_REACH
from recast.logs.hdmap import FASTEST, HdMap, Lane
from recast.simulation.openx import reference_line
from recast.simulation.openx.junctions import Network, network
from recast.simulation.openx.read import XmlFile


@dataclass(frozen=True)
class RoadLane:
    """A road of one lane, as a file tells it.

    Attributes:
        lane_id: id of the lane in the map.
        centreline: (N, 3) points of the reference line at the ends of its pieces, metres.
        widths: (N, 2) distances from the centreline to the left and to the right boundary, metres.
        speed_limit: speed limit in m/s, or None.
        successors: lanes that links and junctions name.
    """

    lane_id: str
    centreline: Array
    widths: Array
    speed_limit: float | None
    successors: tuple[str, ...]


def write_opendrive(path: str | Path, hdmap: HdMap, name: str) -> int:
    """Write a map's lanes, whole or not at all.

    Args:
        name: name of the map, for people.

    Returns:
        Links between lanes that were left out, see `network`.

    Raises:
        InputError: the disk refuses.
    """
    root = ET.Element("OpenDRIVE")
    shown = "".join(c if c.isprintable() else "?" for c in name)
    _add(root, "header", revMajor=1, revMinor=7, name=shown, version="1.00")
    numbers = {key: i for i, key in enumerate(hdmap.lanes)}
    links = network(hdmap.lanes)
    for lane in hdmap.lanes.values():
        _road(root, lane, numbers, links)
    first = len(numbers)  # ids of roads and junctions are all different
    for number, connections in links.connections.items():
        junction = _add(root, "junction", name=f"junction-{number}", id=first + number)
        for i, (incoming, connecting) in enumerate(connections):
            ends = {"incomingRoad": numbers[incoming], "connectingRoad": numbers[connecting]}
            connection = _add(junction, "connection", id=i, **ends, contactPoint="start")
            _add(connection, "laneLink", **{"from": -1, "to": -1})
    ET.indent(root)
    data = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    write_bytes(path, data + b"\n")
    return links.left_out


def _add(parent: ET.Element, tag: str, **attributes: object) -> ET.Element:
    return ET.SubElement(parent, tag, {name: str(value) for name, value in attributes.items()})


def _road(root: ET.Element, lane: Lane, numbers: dict[str, int], links: Network) -> None:
    line = lane.centreline[reference_line.apart(lane.centreline)]
    ways = reference_line.tangents(line[:, :2])
    pieces = [
        reference_line.piece(*line[i : i + 2, :2], *ways[i : i + 2]) for i in range(len(line) - 1)
    ]
    s = np.concatenate([[0.0], np.cumsum([length for _, length in pieces])])
    name, key = quote(lane.lane_id, safe=""), lane.lane_id
    inside = links.junction.get(key)
    junction = -1 if inside is None else len(numbers) + inside
    road = _add(root, "road", name=name, length=float(s[-1]), id=numbers[key], junction=junction)
    link = _add(road, "link")
    ends = (
        ("predecessor", links.before.get(key), "end"),
        ("successor", links.after.get(key), "start"),
    )
    for tag, end, contact in ends:
        if end is not None and end.lane is not None:
            what = {"elementType": "road", "elementId": numbers[end.lane], "contactPoint": contact}
            _add(link, tag, **what)
        elif end is not None and end.junction is not None:
            _add(link, tag, elementType="junction", elementId=len(numbers) + end.junction)
    kind = _add(road, "type", s=0.0, type="town")
    if lane.speed_limit is not None:
        _add(kind, "speed", max=float(lane.speed_limit), unit="m/s")
    view = _add(road, "planView")
    for at, point, tangent, (cubic, length) in zip(s, line, ways, pieces, strict=False):
        hdg = float(np.arctan2(tangent[1], tangent[0]))
        place = {"s": float(at), "x": float(point[0]), "y": float(point[1])}
        geometry = _add(view, "geometry", **place, hdg=hdg, length=length)
        names = [f"{power}{axis}" for axis in "UV" for power in "abcd"]
        values = dict(zip(names, (float(c) for c in cubic.ravel()), strict=True))
        _add(geometry, "paramPoly3", **values, pRange="normalized")
    profile = _add(road, "elevationProfile")
    for row in reference_line.linear(s, line[:, 2]):
        _add(profile, "elevation", **row)
    _add(road, "lateralProfile")
    widths = reference_line.widths(lane, line, ways)
    lanes = _add(road, "lanes")
    for row in reference_line.linear(s, widths[:, 0]):
        _add(lanes, "laneOffset", **row)
    section = _add(lanes, "laneSection", s=0.0)
    centre = _add(_add(section, "center"), "lane", id=0, type="none", level="false")
    _add(centre, "link")
    own = _add(_add(section, "right"), "lane", id=-1, type="driving", level="false")
    own_link = _add(own, "link")
    for tag, end, _ in ends:
        if end is not None and end.lane is not None:
            _add(own_link, tag, id=-1)
    for row in reference_line.linear(s, widths.sum(axis=1), "sOffset"):
        _add(own, "width", **row)


def read_opendrive(path: str | Path) -> dict[str, RoadLane]:
    """The roads of a file that `write_opendrive` wrote, by lane.

    Raises:
        InputError: no such file, see `XmlFile`.
    """
    file = XmlFile(path, "OpenDRIVE")
    roads = file.root.findall("road")
    names = {file.text(road, "id"): unquote(file.text(road, "name")) for road in roads}
    connected: dict[tuple[str, str], list[str]] = {}  # by junction and incoming road
    for junction in file.root.findall("junction"):
        for one in junction.findall("connection"):
            key = file.text(junction, "id"), file.text(one, "incomingRoad")
            other = names.get(file.text(one, "connectingRoad"))
            if other is None:
                raise file.fault("connection", "names a road that is not there")
            connected.setdefault(key, []).append(other)
    found = [_read_road(file, road, names, connected) for road in roads]
    return {one.lane_id: one for one in found}


def _read_road(
    file: XmlFile,
    road: ET.Element,
    names: dict[str, str],
    connected: dict[tuple[str, str], list[str]],
) -> RoadLane:
    def rows(way: str, start: str, s: Array) -> Array:
        """Values at s of a piecewise linear profile."""
        entries = road.findall(way)
        if not entries:
            raise file.fault("road", f"lacks {way}")
        reach = (-WORLD_REACH, WORLD_REACH)
        table = np.array([[file.number(e, n, *reach) for n in (start, "a", "b")] for e in entries])
        row = np.clip(np.searchsorted(table[:, 0], s, "right") - 1, 0, len(table) - 1)
        return table[row, 1] + table[row, 2] * (s - table[row, 0])

    points: list[list[float]] = []
    at: list[float] = []
    for geometry in road.findall("planView/geometry"):
        reach = (-WORLD_REACH, WORLD_REACH)
        names_of = ("s", "x", "y", "hdg", "length")
        start, x, y, hdg, length = (file.number(geometry, name, *reach) for name in names_of)
        poly = file.one(geometry, "paramPoly3")
        u, v = (sum(file.number(poly, f"{p}{axis}", *reach) for p in "abcd") for axis in "UV")
        if not points:
            points, at = [[x, y]], [start]
        sine, cosine = float(np.sin(hdg)), float(np.cos(hdg))
        points.append([x + u * cosine - v * sine, y + u * sine + v * cosine])
        at.append(start + length)
    if not points:
        raise file.fault("road", "has no geometry")
    s: Array = np.array(at)
    left = rows("lanes/laneOffset", "s", s)
    total = rows("lanes/laneSection/right/lane/width", "sOffset", s)
    heights = rows("elevationProfile/elevation", "s", s)
    speed = road.find("type/speed")
    after = road.find("link/successor")
    links: tuple[str, ...] = ()
    if after is not None:
        end = file.text(after, "elementId")
        if file.text(after, "elementType") == "junction":
            links = tuple(connected.get((end, file.text(road, "id")), ()))
        elif end in names:
            links = (names[end],)
        else:
            raise file.fault("successor", "names a road that is not there")
    return RoadLane(
        lane_id=unquote(file.text(road, "name")),
        centreline=np.column_stack([np.array(points), heights]),
        widths=np.column_stack([left, total - left]),
        speed_limit=None if speed is None else file.number(speed, "max", 0, FASTEST),
        successors=links,
    )
