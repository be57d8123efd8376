"""Messages of the Waymo datasets, perception v1 and motion, as far as they are read, and their map.

Fields of dataset.proto, label.proto, map.proto and scenario.proto. The classes are made at run time
in a pool of their own; fields that are not named here are skipped.

The area is not stored: it is the lanes, and the road up to its edges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import shapely
from google.protobuf import message

from recast.core.protos import message_classes, message_fields
from recast.logs import checks
from recast.logs.hdmap import HdMap, Lane, without_holes
from recast.logs.importers.common import NEAR, lane_outline, metres_beside
from recast.logs.types import Array

LICENCE = "Waymo Dataset License Agreement for Non-Commercial Use"


class FieldError(ValueError):
    """A field at fault, named from the record downwards, such as images[2].pose."""

    def __init__(self, field: str, problem: str) -> None:
        self.field = field
        self.problem = problem
        super().__init__(f"{field}: {problem}")


@dataclass(frozen=True)
class ProtoEnum:
    """An enumeration: names by number."""

    name: str
    names: Mapping[int, str]

    def of(self, number: int, where: str) -> str:
        """The name of `number`; raises FieldError where it has none."""
        if number not in self.names:
            known = ", ".join(f"{key} {name}" for key, name in self.names.items())
            raise FieldError(where, f"is {number}, not a {self.name} ({known})")
        return self.names[number]


CAMERA_NAME = ProtoEnum(
    "CameraName",
    {1: "FRONT", 2: "FRONT_LEFT", 3: "FRONT_RIGHT", 4: "SIDE_LEFT", 5: "SIDE_RIGHT"},
)
LASER_NAME = ProtoEnum(
    "LaserName", {1: "TOP", 2: "FRONT", 3: "SIDE_LEFT", 4: "SIDE_RIGHT", 5: "REAR"}
)
ROLLING_SHUTTER = ProtoEnum(
    "RollingShutterReadOutDirection",
    {
        0: "unknown",
        1: "top to bottom",
        2: "left to right",
        3: "bottom to top",
        4: "right to left",
        5: "global",
    },
)
LABEL_TYPE = ProtoEnum(
    "Label.Type", {0: "unknown", 1: "vehicle", 2: "pedestrian", 3: "sign", 4: "cyclist"}
)
_OBJECT_TYPE = ProtoEnum(
    "Track.ObjectType", {0: "unset", 1: "vehicle", 2: "pedestrian", 3: "cyclist", 4: "other"}
)
_LANE_TYPE = ProtoEnum("LaneType", {0: "undefined", 1: "freeway", 2: "surface", 3: "bike"})
_CHOICES = {
    choice.name: choice
    for choice in (CAMERA_NAME, LASER_NAME, ROLLING_SHUTTER, LABEL_TYPE, _OBJECT_TYPE, _LANE_TYPE)
}


def lidar_name(laser: str) -> str:
    """Name of a LiDAR in the log: three of the dataset's own are also names of cameras."""
    return f"lidar_{laser.lower()}"


# Map features are bytes here: they are decoded of the first frame only, as MapFeature.
_PROTO = """
message Vector3d { optional double x = 1; optional double y = 2; optional double z = 3; }
message Transform { repeated double transform = 1; }
message Stats {
  optional string time_of_day = 2; optional string location = 3; optional string weather = 4;
}
message CameraCalibration {
  optional CameraName name = 1;
  repeated double intrinsic = 2;
  optional Transform extrinsic = 3;
  optional int32 width = 4;
  optional int32 height = 5;
  optional RollingShutterReadOutDirection rolling_shutter_direction = 6;
}
message LaserCalibration {
  optional LaserName name = 1;
  repeated double beam_inclinations = 2;
  optional double beam_inclination_min = 3;
  optional double beam_inclination_max = 4;
  optional Transform extrinsic = 5;
}
message Context {
  optional string name = 1;
  repeated CameraCalibration camera_calibrations = 2;
  repeated LaserCalibration laser_calibrations = 3;
  optional Stats stats = 4;
}
message CameraImage {
  optional CameraName name = 1;
  optional bytes image = 2;
  optional Transform pose = 3;
  optional double pose_timestamp = 5;
  optional double shutter = 6;
  optional double camera_trigger_time = 7;
  optional double camera_readout_done_time = 8;
}
message RangeImage {
  optional bytes range_image_compressed = 2; optional bytes pose_compressed = 4;
}
message Laser {
  optional LaserName name = 1; optional RangeImage return1 = 2; optional RangeImage return2 = 3;
}
message Box {
  optional double center_x = 1; optional double center_y = 2; optional double center_z = 3;
  optional double width = 4; optional double length = 5; optional double height = 6;
  optional double heading = 7;
}
message Label { optional Box box = 1; optional Label.Type type = 3; optional string id = 4; }
message Frame {
  optional Context context = 1;
  optional int64 timestamp_micros = 2;
  optional Transform pose = 3;
  repeated CameraImage images = 4;
  repeated Laser lasers = 5;
  repeated Label laser_labels = 6;
  repeated bytes map_features = 10;
  optional Vector3d map_pose_offset = 11;
}
message MatrixShape { repeated int32 dims = 1; }
message MatrixFloat { repeated float data = 1; optional MatrixShape shape = 2; }
message Polyline { repeated Vector3d polyline = 2; }
message Polygon { repeated Vector3d polygon = 1; }
message BoundarySegment {
  optional int32 lane_start_index = 1;
  optional int32 lane_end_index = 2;
  optional int64 boundary_feature_id = 3;
}
message LaneNeighbor {
  optional int64 feature_id = 1;
  optional int32 self_start_index = 2;
  optional int32 self_end_index = 3;
}
message LaneCenter {
  optional double speed_limit_mph = 1;
  optional LaneType type = 2;
  optional bool interpolating = 3;
  repeated Vector3d polyline = 8;
  repeated int64 exit_lanes = 10;
  repeated LaneNeighbor left_neighbors = 11;
  repeated LaneNeighbor right_neighbors = 12;
  repeated BoundarySegment left_boundaries = 13;
  repeated BoundarySegment right_boundaries = 14;
}
message MapFeature {
  optional int64 id = 1;
  optional LaneCenter lane = 3;
  optional Polyline road_line = 4;
  optional Polyline road_edge = 5;
  optional Polygon driveway = 10;
}
message ObjectState {
  optional double center_x = 2; optional double center_y = 3; optional double center_z = 4;
  optional float length = 5; optional float width = 6; optional float height = 7;
  optional float heading = 8; optional bool valid = 11;
}
message Track {
  optional int32 id = 1; optional Track.ObjectType object_type = 2; repeated ObjectState states = 3;
}
message ScenarioHead { repeated bytes tracks = 2; optional string scenario_id = 5; }
message Scenario {
  repeated double timestamps_seconds = 1;
  repeated Track tracks = 2;
  optional string scenario_id = 5;
  optional int32 sdc_track_index = 6;
  repeated bytes map_features = 8;
}
"""
_TYPES = {"float": np.float32, "double": np.float64, "int32": np.int64, "int64": np.int64}
_FIELDS = message_fields(_PROTO)


@cache
def _classes() -> dict[str, type[message.Message]]:
    # An enumeration's own type would hide numbers without a name.
    return message_classes({"waymo": _PROTO}, "proto2", dict.fromkeys(_CHOICES, "int32"))


class Message:
    """A decoded message; see `decode`.

    Attributes:
        where: its name from the record downwards.
    """

    __slots__ = ("_data", "_fields", "where")

    def __init__(self, data: Any, kind: str, where: str) -> None:
        self._data, self._fields, self.where = data, _FIELDS[kind], where

    def __getitem__(self, name: str) -> Any:
        """The value of a field; raises FieldError where it is absent, see also `get`."""
        value = self.get(name)
        if value is None:
            raise FieldError(self.path(name), "is missing")
        return value

    def get(self, name: str, otherwise: Any = None) -> Any:
        """The value of a field, or `otherwise`; repeated numbers are an array, others a list.
        Raises FieldError: an enumeration has an unknown value, or a text is none."""
        repeated, kind, _ = self._fields[name]
        if not repeated and not self._data.HasField(name):
            return otherwise
        value = getattr(self._data, name)
        if kind in _FIELDS:
            if not repeated:
                return Message(value, kind, self.path(name))
            where = self.path(name)
            return [Message(one, kind, f"{where}[{i}]") for i, one in enumerate(value)]
        if repeated:
            return list(value) if kind == "bytes" else np.array(value, _TYPES[kind])
        if kind in _CHOICES:
            return _CHOICES[kind].of(value, self.path(name))
        if isinstance(value, bytes) and kind == "string":
            raise FieldError(self.path(name), "is not text")
        return value

    def path(self, name: str) -> str:
        """The name of a field from the record downwards."""
        return f"{self.where}.{name}" if self.where else name


def decode(kind: str, data: bytes, where: str = "") -> Message:
    """The message `kind`, such as "Frame", that `data` are. Raises FieldError: they are none."""
    try:
        return Message(_classes()[f"waymo.{kind}"].FromString(data), kind, where)
    except message.DecodeError:
        raise FieldError(where or kind, "is not a protocol buffer, or is cut off") from None


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
