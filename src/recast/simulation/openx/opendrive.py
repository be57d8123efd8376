"""OpenDRIVE 1.7 (ASAM) of a map's lanes: one road a lane.

The reference line is the lane's centreline: a cubic between each two of its points, with the same
direction on both sides of a point (Catmull-Rom). Heights and widths change linearly between points.
A lane's successor becomes a link if neither has another one. Where lanes part or join, OpenDRIVE
wants a junction, which is not written: those links are left out and counted. Neighbours lie beside
each other, but are not told: they would have to be lanes of one road. Drivable areas beside the
lanes have no place in the format.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np

from recast.arrays import Array
from recast.core.files import write_bytes
from recast.logs.checks import WORLD_REACH
from recast.logs.hdmap import FASTEST, HdMap, Lane
from recast.simulation.openx.read import XmlFile

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_CLOSEST = 1e-3  # metres between points of a reference line
_WIDEST = 1000.0  # metres


@dataclass(frozen=True)
class RoadLane:
    """A road of one lane, as a file tells it.

    Attributes:
        lane_id: of the map.
        centreline: (N, 3) points of the reference line at the ends of its pieces, metres.
        widths: (N, 2) from there to the left and to the right boundary, metres.
        speed_limit: m/s, or None.
        successors: lanes that a link names.
    """

    lane_id: str
    centreline: Array
    widths: Array
    speed_limit: float | None
    successors: tuple[str, ...]


def write_opendrive(path: str | Path, hdmap: HdMap, name: str) -> int:
    """Write a map's lanes, whole or not at all.

    Args:
        name: of the map, for people.

    Returns:
        Links between lanes that were left out, since lanes part or join there.

    Raises:
        InputError: the disk refuses.
    """
    root = ET.Element("OpenDRIVE")
    shown = "".join(c if c.isprintable() else "?" for c in name)
    _add(root, "header", revMajor=1, revMinor=7, name=shown, version="1.00")
    numbers = {key: i for i, key in enumerate(hdmap.lanes)}
    before = Counter(other for lane in hdmap.lanes.values() for other in lane.successors)
    single = {
        key: lane.successors[0]
        for key, lane in hdmap.lanes.items()
        if len(lane.successors) == 1 and before[lane.successors[0]] == 1
    }
    behind = {other: key for key, other in single.items()}
    for key, lane in hdmap.lanes.items():
        _road(root, lane, numbers, behind.get(key), single.get(key))
    ET.indent(root)
    data = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    write_bytes(path, data + b"\n")
    return sum(before.values()) - len(single)


def _add(parent: ET.Element, tag: str, **attributes: object) -> ET.Element:
    return ET.SubElement(parent, tag, {name: str(value) for name, value in attributes.items()})


def _road(
    root: ET.Element, lane: Lane, numbers: dict[str, int], before: str | None, after: str | None
) -> None:
    line = lane.centreline[_apart(lane.centreline)]
    tangents = _tangents(line[:, :2])
    pieces = [_piece(*line[i : i + 2, :2], *tangents[i : i + 2]) for i in range(len(line) - 1)]
    s = np.concatenate([[0.0], np.cumsum([length for _, length in pieces])])
    name, number = quote(lane.lane_id, safe=""), numbers[lane.lane_id]
    road = _add(root, "road", name=name, length=float(s[-1]), id=number, junction=-1)
    link = _add(road, "link")
    for tag, other, contact in (("predecessor", before, "end"), ("successor", after, "start")):
        if other is not None:
            what = {"elementType": "road", "elementId": numbers[other], "contactPoint": contact}
            _add(link, tag, **what)
    kind = _add(road, "type", s=0.0, type="town")
    if lane.speed_limit is not None:
        _add(kind, "speed", max=float(lane.speed_limit), unit="m/s")
    view = _add(road, "planView")
    for at, point, tangent, (cubic, length) in zip(s, line, tangents, pieces, strict=False):
        hdg = float(np.arctan2(tangent[1], tangent[0]))
        place = {"s": float(at), "x": float(point[0]), "y": float(point[1])}
        geometry = _add(view, "geometry", **place, hdg=hdg, length=length)
        names = [f"{power}{axis}" for axis in "UV" for power in "abcd"]
        values = dict(zip(names, (float(c) for c in cubic.ravel()), strict=True))
        _add(geometry, "paramPoly3", **values, pRange="normalized")
    profile = _add(road, "elevationProfile")
    for row in _linear(s, line[:, 2]):
        _add(profile, "elevation", **row)
    _add(road, "lateralProfile")
    widths = _widths(lane, line, tangents)
    lanes = _add(road, "lanes")
    for row in _linear(s, widths[:, 0]):
        _add(lanes, "laneOffset", **row)
    section = _add(lanes, "laneSection", s=0.0)
    centre = _add(_add(section, "center"), "lane", id=0, type="none", level="false")
    _add(centre, "link")
    own = _add(_add(section, "right"), "lane", id=-1, type="driving", level="false")
    ends = _add(own, "link")
    for tag, other in (("predecessor", before), ("successor", after)):
        if other is not None:
            _add(ends, tag, id=-1)
    for row in _linear(s, widths.sum(axis=1), "sOffset"):
        _add(own, "width", **row)


def _apart(line: Array) -> Array:
    """Indices of points that are not nearly the same as the one before; two at least."""
    kept = [0]
    for i in range(1, len(line)):
        if np.linalg.norm(line[i, :2] - line[kept[-1], :2]) >= _CLOSEST:
            kept.append(i)
    return np.array(kept if len(kept) > 1 else [0, len(line) - 1])


def _tangents(points: Array) -> Array:
    """(N, 2) unit directions: along the chord between a point's neighbours."""
    chords = np.concatenate([points[1:2] - points[:1], points[2:] - points[:-2]])
    chords = np.concatenate([chords, points[-1:] - points[-2:-1]])
    steps = np.diff(points, axis=0)[np.minimum(np.arange(len(points)), len(points) - 2)]
    # A line that turns back on itself has no chord: there its next step gives the direction.
    chords = np.where(np.linalg.norm(chords, axis=1, keepdims=True) < _CLOSEST, steps, chords)
    return chords / np.maximum(np.linalg.norm(chords, axis=1, keepdims=True), 1e-12)


def _piece(start: Array, end: Array, first: Array, last: Array) -> tuple[Array, float]:
    """A cubic's coefficients a..d of u and v, (2, 4), in the axes of its start; and its length."""
    turn = np.array([[first[0], first[1]], [-first[1], first[0]]])
    chord, out = turn @ (end - start), turn @ last
    size = float(np.linalg.norm(chord))
    t0, t1 = np.array([size, 0.0]), out * size
    cubic = np.stack([np.zeros(2), t0, 3 * chord - 2 * t0 - t1, t0 + t1 - 2 * chord], axis=1)
    p = (_NODES + 1) / 2
    speed = cubic[:, 1:] @ np.stack([np.ones_like(p), 2 * p, 3 * p**2])
    return cubic, float(np.linalg.norm(speed, axis=0) @ _WEIGHTS / 2)


def _linear(s: Array, values: Array, start: str = "s") -> list[dict[str, float]]:
    """Rows a + b ds that go through the values at s; all but the last point begin one."""
    slopes = np.diff(values) / np.maximum(np.diff(s), 1e-12)
    return [
        {start: float(at), "a": float(a), "b": float(b), "c": 0.0, "d": 0.0}
        for at, a, b in zip(s[:-1], values[:-1], slopes, strict=True)
    ]


def _widths(lane: Lane, line: Array, tangents: Array) -> Array:
    """(N, 2) metres from the centreline to the left and right boundary, at right angles."""
    left = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)
    sides = ((lane.left_boundary, left), (lane.right_boundary, -left))
    return np.stack([_to(b[:, :2], line[:, :2], way) for b, way in sides], axis=1)


def _to(boundary: Array, points: Array, ways: Array) -> Array:
    """(N,) distances from points along directions to a polyline; to its nearest point if beside."""
    a, step = boundary[:-1], np.diff(boundary, axis=0)
    gap = a[None] - points[:, None]
    cross = ways[:, None, 0] * step[None, :, 1] - ways[:, None, 1] * step[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (gap[..., 0] * step[:, 1] - gap[..., 1] * step[:, 0]) / cross
        share = (gap[..., 0] * ways[:, None, 1] - gap[..., 1] * ways[:, None, 0]) / cross
    hit = np.where((share >= 0) & (share <= 1) & (along >= 0), along, np.inf).min(axis=1)
    length = np.maximum((step**2).sum(axis=1), 1e-12)
    foot = np.clip(-(gap * step).sum(axis=2) / length, 0, 1)
    nearest = np.linalg.norm(gap + foot[..., None] * step, axis=2).min(axis=1)
    return np.where(np.isfinite(hit) & (hit < 2 * nearest + _CLOSEST), hit, nearest)


def read_opendrive(path: str | Path) -> dict[str, RoadLane]:
    """The roads of a file that `write_opendrive` wrote, by lane.

    Raises:
        InputError: no such file, see `XmlFile`.
    """
    file = XmlFile(path, "OpenDRIVE")
    roads = file.root.findall("road")
    names = {file.text(road, "id"): unquote(file.text(road, "name")) for road in roads}
    found = [_read_road(file, road, names) for road in roads]
    return {one.lane_id: one for one in found}


def _read_road(file: XmlFile, road: ET.Element, names: dict[str, str]) -> RoadLane:
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
    links = () if after is None else (names.get(file.text(after, "elementId"), ""),)
    return RoadLane(
        lane_id=unquote(file.text(road, "name")),
        centreline=np.column_stack([np.array(points), heights]),
        widths=np.column_stack([left, total - left]),
        speed_limit=None if speed is None else file.number(speed, "max", 0, FASTEST),
        successors=links,
    )
