"""Waymo map features to lanes and drivable area; perception and motion dataset have the same.

The area is not stored: it is the lanes, and the road up to its edges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import shapely

from recast.logs import checks
from recast.logs.hdmap import HdMap, Lane, without_holes
from recast.logs.importers.common import NEAR, lane_outline, metres_beside
from recast.logs.importers.waymo_proto import FieldError, Message, decode
from recast.logs.types import Array

REACH = 5.0
"""Metres from a lane's side within which a road edge still bounds the same road: a shoulder, or
parking and bicycle lane."""
_SEAM = 0.3
"""Metres: narrower gaps between lanes are seams of their outlines."""
_SMALLEST = 1.0
"""Square metres of an outline that is kept."""
MPH = 0.44704
"""Metres per second."""
HALF_WIDTH = 1.75
"""Metres from the centreline to either side where no boundary is named."""
_NARROWEST, _WIDEST = 0.5, 5.0
"""Metres from the centreline to a boundary; farther, such as where a lane forks, it is not the
lane's own."""


def hd_map(features: Sequence[Message], shift: Array, ego: Array) -> HdMap:
    """Lanes for cars and drivable area of map features.

    Lanes have their own centreline. Their sides are at the boundaries named for each of its points,
    else 1.75 m off. Bicycle lanes are only drivable area, lanes of a single point nothing. Of
    several neighbours on a side, the one along the longest stretch is kept.

    Args:
        features: decoded MapFeature messages.
        shift: (3,) world coordinates = map coordinates + shift.
        ego: (T, 2) places of the ego in the world.

    Raises:
        FieldError: a field is missing or wrong, there is no lane for cars, or the map lies
            elsewhere than the drive.
    """
    lines = _lines(features, shift)
    messages: dict[str, Message] = {}
    centres: dict[str, Array] = {}
    for feature in features:
        lane = feature.get("lane")
        if lane is None:
            continue
        key = str(feature["id"])
        centre = _points(lane, "polyline", shift)
        if len(centre) >= 2 and np.any(np.ptp(centre[:, :2], axis=0) > 0):
            messages[key], centres[key] = lane, centre
    ribbons = {key: _ribbon(centres[key], messages[key], lines) for key in messages}
    driven = {key: lane for key, lane in messages.items() if lane.get("type") != "bike"}
    if not driven:
        raise FieldError("map_features", "contain no lane for cars")
    lanes = {key: _lane(key, driven, centres[key], *ribbons[key]) for key in driven}
    distance = metres_beside(lanes, ego)
    if distance > NEAR:
        problem = (
            f"the ego drives {distance:.0f} m away from all lanes: the map is of another drive"
        )
        raise FieldError("map_features", problem)
    edges = [lines[feature["id"]] for feature in features if feature.get("road_edge")]
    driveways = [
        _points(feature["driveway"], "polygon", shift)[:, :2]
        for feature in features
        if feature.get("driveway")
    ]
    try:
        area = drivable_area(list(ribbons.values()), edges, driveways)
    except (shapely.errors.ShapelyError, RecursionError) as error:
        raise FieldError("map_features", f"cannot be joined to an area ({error})") from None
    return HdMap(
        lanes=lanes,
        drivable_area=area,
        notes={"source": "Waymo"},
    )


def decode_features(stored: Sequence[bytes]) -> tuple[Message, ...]:
    """The map features of a frame or scenario; raises FieldError where one is none."""
    return tuple(decode("MapFeature", data, f"map_features[{i}]") for i, data in enumerate(stored))


def _lines(features: Sequence[Message], shift: Array) -> dict[int, Array]:
    """Road lines and road edges (N, 3) by feature id."""
    lines = {}
    for feature in features:
        for kind in ("road_line", "road_edge"):
            if feature.get(kind):
                lines[feature["id"]] = _points(feature[kind], "polyline", shift)
    return lines


def _points(message: Message, name: str, shift: Array) -> Array:
    rows = [[point["x"], point["y"], point.get("z", 0.0)] for point in message[name]]
    points: Array = np.array(rows, np.float64).reshape(-1, 3) + shift
    if not np.all(np.abs(points) <= checks.WORLD_REACH):  # also NaN
        problem = f"holds a point that is not finite, or not within {checks.WORLD_REACH:g} m"
        raise FieldError(message.path(name), problem)
    return points


def _ribbon(centre: Array, lane: Message, lines: Mapping[int, Array]) -> tuple[Array, Array]:
    """Left and right boundary (N, 3) of a lane, a point beside each point of its centreline."""
    left = _left_of(centre)
    sides = []
    for name, normal in (("left_boundaries", left), ("right_boundaries", -left)):
        width = np.full(len(centre), HALF_WIDTH)
        for part in lane[name]:
            line = lines.get(part["boundary_feature_id"])
            if line is None or len(line) < 2:
                continue
            first, last = part.get("lane_start_index", 0), part.get("lane_end_index", 0)
            if not 0 <= first <= last < len(centre):
                problem = (
                    f"runs from point {first} to {last}, but the lane has {len(centre)} points"
                )
                raise FieldError(part.where, problem)
            points = shapely.points(centre[first : last + 1, :2])
            distance = shapely.distance(points, shapely.LineString(line[:, :2]))
            width[first : last + 1] = np.where(
                distance <= _WIDEST, np.maximum(distance, _NARROWEST), HALF_WIDTH
            )
        sides.append(centre + width[:, None] * np.pad(normal, ((0, 0), (0, 1))))
    return sides[0], sides[1]


def _left_of(line: Array) -> Array:
    """Unit vectors (N, 2) to the left of a line (N, 3) at its points."""
    place = line[:, :2]
    ahead = np.concatenate([place[1:], place[-1:]]) - np.concatenate([place[:1], place[:-1]])
    length = np.linalg.norm(ahead, axis=1)
    # A point that comes twice looks where its nearest predecessor looks, or else its successor.
    known = np.flatnonzero(length > 0)
    source = known[np.maximum(np.searchsorted(known, np.arange(len(line)), side="right") - 1, 0)]
    ahead = ahead[source] / length[source, None]
    return np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)


def _lane(key: str, lanes: Mapping[str, Message], centre: Array, left: Array, right: Array) -> Lane:
    message = lanes[key]
    mph = message.get("speed_limit_mph", 0.0)
    if not 0 <= mph < np.inf:
        raise FieldError(
            message.path("speed_limit_mph"), f"is {mph:g}, not a finite speed of 0 or more"
        )
    successors = dict.fromkeys(str(other) for other in message["exit_lanes"])
    return Lane(
        lane_id=key,
        centreline=centre,
        left_boundary=left,
        right_boundary=right,
        polygon=lane_outline(left, right),
        speed_limit=mph * MPH if mph > 0 else None,
        successors=tuple(other for other in successors if other in lanes and other != key),
        left_neighbour=_neighbour(message["left_neighbors"], key, lanes),
        right_neighbour=_neighbour(message["right_neighbors"], key, lanes),
        is_intersection=bool(message.get("interpolating", 0)),
    )


def _neighbour(neighbours: list[Message], key: str, lanes: Mapping[str, Message]) -> str | None:
    def stretch(neighbour: Message) -> int:
        return int(neighbour.get("self_end_index", 0) - neighbour.get("self_start_index", 0))

    named = [(stretch(n), str(n["feature_id"])) for n in neighbours]
    usable = [(length, other) for length, other in named if other in lanes and other != key]
    return max(usable, key=lambda row: row[0])[1] if usable else None


def drivable_area(
    ribbons: Sequence[tuple[Array, Array]], edges: Sequence[Array], driveways: Sequence[Array]
) -> tuple[Array, ...]:
    """Outlines (N, 2) of where one can drive, without holes.

    The union of all lanes and driveways, of the strips between a lane's side and the road edge
    beside it, and of the gaps enclosed by these in which no road edge lies, such as the middle of
    an intersection.

    Args:
        ribbons: left and right boundary (N, 3) of each lane, point beside point.
        edges: road edges (N, 3).
        driveways: outlines (N, 2).
    """
    lines = [shapely.LineString(edge[:, :2]) for edge in edges if len(edge) >= 2]
    parts: list[shapely.Geometry] = []
    for left, right in ribbons:
        parts += _between(left[:, :2], right[:, :2])
        parts += _shoulder(left[:, :2], right[:, :2], lines)
        parts += _shoulder(right[:, :2], left[:, :2], lines)
    parts += [shapely.Polygon(outline) for outline in driveways if len(outline) >= 3]
    area = shapely.union_all([shapely.make_valid(part) for part in parts])
    area = area.buffer(_SEAM, join_style="mitre").buffer(-_SEAM, join_style="mitre")
    kerbs = shapely.union_all(lines)
    outlines = []
    for polygon in _polygons(area):
        islands = [hole for hole in polygon.interiors if shapely.Polygon(hole).intersects(kerbs)]
        filled = shapely.Polygon(polygon.exterior, islands)
        outlines += [
            shapely.get_coordinates(piece.exterior)[:-1]
            for piece in without_holes(filled)
            if piece.area >= _SMALLEST
        ]
    return tuple(outlines)


def _between(first: Array, second: Array) -> list[shapely.Polygon]:
    """What lies between two lines (N >= 2, 2), point beside point."""
    whole = shapely.Polygon(np.concatenate([first, second[::-1]]))
    if whole.is_valid:
        return [whole]
    # A sharp inner bend folds a ribbon over itself; the quadrangles between its points stay simple.
    corners = np.stack([first[:-1], first[1:], second[1:], second[:-1]], axis=1)
    return list(shapely.polygons(corners))


def _shoulder(side: Array, other: Array, edges: list[shapely.LineString]) -> list[shapely.Polygon]:
    """Between a lane's side (N, 2) and the first road edge beyond it, seen from the other side."""
    outwards = side - other
    outwards /= np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-9)
    rays = shapely.linestrings(np.stack([side, side + REACH * outwards], axis=1))
    tree = shapely.STRtree(edges)
    ray, edge = tree.query(rays, predicate="intersects")
    hits = shapely.intersection(rays[ray], np.array(edges, object)[edge])
    width = np.full(len(side), np.inf)
    np.minimum.at(width, ray, shapely.distance(shapely.points(side)[ray], hits))
    reached = np.isfinite(width)
    beyond = side + np.where(reached, width, 0.0)[:, None] * outwards
    runs = np.split(np.arange(len(side)), np.flatnonzero(np.diff(reached)) + 1)
    return [
        part
        for run in runs
        if reached[run[0]] and len(run) >= 2
        for part in _between(side[run], beyond[run])
    ]


def _polygons(area: shapely.Geometry) -> list[shapely.Polygon]:
    return [part for part in shapely.get_parts(area) if part.geom_type == "Polygon"]
