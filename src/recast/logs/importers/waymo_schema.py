"""Messages of the Waymo Open Dataset v1 and of its motion dataset, as far as they are read.

Field numbers of dataset.proto, label.proto, map.proto and scenario.proto.
"""

from __future__ import annotations

from recast.logs.importers.waymo_wire import Choice, Kind, Schema, many, one

INT, DOUBLE, FLOAT, STRING, SPAN = Kind.INT, Kind.DOUBLE, Kind.FLOAT, Kind.STRING, Kind.SPAN

LICENCE = "Waymo Dataset License Agreement for Non-Commercial Use"

CAMERA_NAME = Choice(
    "CameraName",
    {1: "FRONT", 2: "FRONT_LEFT", 3: "FRONT_RIGHT", 4: "SIDE_LEFT", 5: "SIDE_RIGHT"},
)
LASER_NAME = Choice("LaserName", {1: "TOP", 2: "FRONT", 3: "SIDE_LEFT", 4: "SIDE_RIGHT", 5: "REAR"})


def lidar_name(laser: str) -> str:
    """Name of a LiDAR in the log: three of the dataset's own are also names of cameras."""
    return f"lidar_{laser.lower()}"


ROLLING_SHUTTER = Choice(
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
LABEL_TYPE = Choice(
    "Label.Type", {0: "unknown", 1: "vehicle", 2: "pedestrian", 3: "sign", 4: "cyclist"}
)
OBJECT_TYPE = Choice(
    "Track.ObjectType", {0: "unset", 1: "vehicle", 2: "pedestrian", 3: "cyclist", 4: "other"}
)
LANE_TYPE = Choice("LaneType", {0: "undefined", 1: "freeway", 2: "surface", 3: "bike"})

VECTOR = Schema("Vector3d", {1: one("x", DOUBLE), 2: one("y", DOUBLE), 3: one("z", DOUBLE)})
TRANSFORM = Schema("Transform", {1: many("transform", DOUBLE)})

STATS = Schema(
    "Stats", {2: one("time_of_day", STRING), 3: one("location", STRING), 4: one("weather", STRING)}
)
CAMERA_CALIBRATION = Schema(
    "CameraCalibration",
    {
        1: one("name", CAMERA_NAME),
        2: many("intrinsic", DOUBLE),
        3: one("extrinsic", TRANSFORM),
        4: one("width", INT),
        5: one("height", INT),
        6: one("rolling_shutter_direction", ROLLING_SHUTTER),
    },
)
LASER_CALIBRATION = Schema(
    "LaserCalibration",
    {
        1: one("name", LASER_NAME),
        2: many("beam_inclinations", DOUBLE),
        3: one("beam_inclination_min", DOUBLE),
        4: one("beam_inclination_max", DOUBLE),
        5: one("extrinsic", TRANSFORM),
    },
)
CONTEXT = Schema(
    "Context",
    {
        1: one("name", STRING),
        2: many("camera_calibrations", CAMERA_CALIBRATION),
        3: many("laser_calibrations", LASER_CALIBRATION),
        4: one("stats", STATS),
    },
)
CAMERA_IMAGE = Schema(
    "CameraImage",
    {
        1: one("name", CAMERA_NAME),
        2: one("image", SPAN),
        3: one("pose", TRANSFORM),
        5: one("pose_timestamp", DOUBLE),
        6: one("shutter", DOUBLE),
        7: one("camera_trigger_time", DOUBLE),
        8: one("camera_readout_done_time", DOUBLE),
    },
)
RANGE_IMAGE = Schema(
    "RangeImage", {2: one("range_image_compressed", SPAN), 4: one("pose_compressed", SPAN)}
)
LASER = Schema(
    "Laser",
    {1: one("name", LASER_NAME), 2: one("return1", RANGE_IMAGE), 3: one("return2", RANGE_IMAGE)},
)
BOX = Schema(
    "Box",
    {
        number: one(name, DOUBLE)
        for number, name in enumerate(
            ("center_x", "center_y", "center_z", "width", "length", "height", "heading"), start=1
        )
    },
)
LABEL = Schema("Label", {1: one("box", BOX), 3: one("type", LABEL_TYPE), 4: one("id", STRING)})
FRAME = Schema(
    "Frame",
    {
        1: one("context", CONTEXT),
        2: one("timestamp_micros", INT),
        3: one("pose", TRANSFORM),
        4: many("images", CAMERA_IMAGE),
        5: many("lasers", LASER),
        6: many("laser_labels", LABEL),
        10: many("map_features", SPAN),
        11: one("map_pose_offset", VECTOR),
    },
)
"""Map features are decoded of the first frame only, with MAP_FEATURE."""

MATRIX_SHAPE = Schema("MatrixShape", {1: many("dims", INT)})
MATRIX_FLOAT = Schema("MatrixFloat", {1: many("data", FLOAT), 2: one("shape", MATRIX_SHAPE)})

POLYLINE = Schema("polyline", {2: many("polyline", VECTOR)})
POLYGON = Schema("polygon", {1: many("polygon", VECTOR)})
BOUNDARY_SEGMENT = Schema(
    "BoundarySegment",
    {
        1: one("lane_start_index", INT),
        2: one("lane_end_index", INT),
        3: one("boundary_feature_id", INT),
    },
)
LANE_NEIGHBOR = Schema(
    "LaneNeighbor",
    {1: one("feature_id", INT), 2: one("self_start_index", INT), 3: one("self_end_index", INT)},
)
LANE = Schema(
    "LaneCenter",
    {
        1: one("speed_limit_mph", DOUBLE),
        2: one("type", LANE_TYPE),
        3: one("interpolating", INT),
        8: many("polyline", VECTOR),
        10: many("exit_lanes", INT),
        11: many("left_neighbors", LANE_NEIGHBOR),
        12: many("right_neighbors", LANE_NEIGHBOR),
        13: many("left_boundaries", BOUNDARY_SEGMENT),
        14: many("right_boundaries", BOUNDARY_SEGMENT),
    },
)
MAP_FEATURE = Schema(
    "MapFeature",
    {
        1: one("id", INT),
        3: one("lane", LANE),
        4: one("road_line", POLYLINE),
        5: one("road_edge", POLYLINE),
        10: one("driveway", POLYGON),
    },
)

OBJECT_STATE = Schema(
    "ObjectState",
    {
        2: one("center_x", DOUBLE),
        3: one("center_y", DOUBLE),
        4: one("center_z", DOUBLE),
        5: one("length", FLOAT),
        6: one("width", FLOAT),
        7: one("height", FLOAT),
        8: one("heading", FLOAT),
        11: one("valid", INT),
    },
)
TRACK = Schema(
    "Track",
    {1: one("id", INT), 2: one("object_type", OBJECT_TYPE), 3: many("states", OBJECT_STATE)},
)
SCENARIO = Schema(
    "Scenario",
    {
        1: many("timestamps_seconds", DOUBLE),
        2: many("tracks", TRACK),
        5: one("scenario_id", STRING),
        6: one("sdc_track_index", INT),
        8: many("map_features", SPAN),
    },
)
