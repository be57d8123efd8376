"""Messages of the Waymo Open Dataset v1 and of its motion dataset, as far as they are read.

Fields of dataset.proto, label.proto, map.proto and scenario.proto. The classes are made at run time
in a pool of their own; fields that are not named here are skipped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from google.protobuf import message

from recast.core.protos import message_classes, message_fields

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
