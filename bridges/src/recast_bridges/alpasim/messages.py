"""Messages of AlpaSim and NuRec: packages common, nre.grpc.protos.sensorsim and egodriver.

The wire knows field numbers and types, not names: nested messages are written side by side here,
members of a oneof as plain members, and message types that recast never looks into as bytes.
`alpasim_grpc` may be imported in the same process: these classes live in a pool of their own.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from recast.core.protos import message_classes

COMMON = "common"
SENSORSIM = "nre.grpc.protos.sensorsim"
EGODRIVER = "egodriver"

TABLES = {
    COMMON: """
message Empty {}
message Vec3 { float x = 1; float y = 2; float z = 3; }
message Quat { float w = 1; float x = 2; float y = 3; float z = 4; }
message Pose { Vec3 vec = 1; Quat quat = 2; }
message PoseAtTime { Pose pose = 1; fixed64 timestamp_us = 2; }
message DynamicState {
  Vec3 angular_velocity = 1; Vec3 linear_velocity = 2;
  Vec3 linear_acceleration = 3; Vec3 angular_acceleration = 4;
}
message StateAtTime { fixed64 timestamp_us = 1; Pose pose = 2; DynamicState state = 3; }
message Trajectory { repeated PoseAtTime poses = 1; }
message AABB { float size_x = 1; float size_y = 2; float size_z = 3; }
message ApiVersion { uint32 major = 1; uint32 minor = 2; uint32 patch = 3; }
message VersionId { string version_id = 1; string git_hash = 2; ApiVersion grpc_api_version = 3; }
message SessionRequestStatus {}
message AvailableScenesReturn { repeated string scene_ids = 1; }
""",
    SENSORSIM: """
enum ShutterType {
  UNKNOWN = 0; TOP_TO_BOTTOM = 1; LEFT_TO_RIGHT = 2; BOTTOM_TO_TOP = 3; RIGHT_TO_LEFT = 4;
  GLOBAL = 5;
}
enum ImageFormat {
  UNDEFINED = 0; PNG = 1; JPEG = 2; JPEG2000 = 3; RGB_UINT8_PLANAR = 4; AVC = 5; AV1 = 6;
}
enum ReferencePolynomial { UNKNOWN = 0; PIXELDIST_TO_ANGLE = 1; ANGLE_TO_PIXELDIST = 2; }
enum WindshieldPolynomial { FORWARD = 0; BACKWARD = 1; }
message LinearCde { double linear_c = 1; double linear_d = 2; double linear_e = 3; }
message FthetaCameraParam {
  double principal_point_x = 1; double principal_point_y = 2;
  ReferencePolynomial reference_poly = 3;
  repeated double pixeldist_to_angle_poly = 4; repeated double angle_to_pixeldist_poly = 5;
  double max_angle = 6; LinearCde linear_cde = 7;
}
message OpenCVPinholeCameraParam {
  double principal_point_x = 1; double principal_point_y = 2;
  double focal_length_x = 3; double focal_length_y = 4;
  repeated double radial_coeffs = 5; repeated double tangential_coeffs = 6;
  repeated double thin_prism_coeffs = 7;
}
message OpenCVFisheyeCameraParam {
  double principal_point_x = 1; double principal_point_y = 2;
  double focal_length_x = 3; double focal_length_y = 4;
  repeated double radial_coeffs = 5; double max_angle = 6;
}
message WindshieldParam {
  WindshieldPolynomial reference_poly = 1;
  repeated double horizontal_poly = 2; repeated double vertical_poly = 3;
  repeated double horizontal_poly_inverse = 4; repeated double vertical_poly_inverse = 5;
}
message CameraSpec {
  FthetaCameraParam ftheta_param = 2; OpenCVPinholeCameraParam opencv_pinhole_param = 3;
  OpenCVFisheyeCameraParam opencv_fisheye_param = 4;
  string logical_id = 5; uint32 resolution_h = 7; uint32 resolution_w = 8;
  ShutterType shutter_type = 9; WindshieldParam bivariate_windshield_model_param = 10;
}
message PosePair { common.Pose start_pose = 1; common.Pose end_pose = 2; }
message DynamicObject { string track_id = 1; PosePair pose_pair = 2; }
message EgoMaskId { string camera_logical_id = 1; string rig_config_id = 2; }
message EgoMaskMetadata { EgoMaskId ego_mask_id = 1; }
message AvailableEgoMasksReturn { repeated EgoMaskMetadata ego_mask_metadata = 1; }
message RGBRenderRequest {
  string scene_id = 1; uint32 resolution_h = 2; uint32 resolution_w = 3;
  CameraSpec camera_intrinsics = 4; fixed64 frame_start_us = 5; fixed64 frame_end_us = 6;
  PosePair sensor_pose = 7; repeated DynamicObject dynamic_objects = 8;
  ImageFormat image_format = 9; float image_quality = 10;
  bool insert_ego_mask = 11; EgoMaskId ego_mask_id = 12;
  PosePair ego_pose = 13; PosePair challenge_ego_pose = 1013;
}
message RGBRenderReturn { bytes image_bytes = 1; }
message BatchItem { string camera_name = 1; RGBRenderRequest request = 2; }
message BatchRGBRenderRequest { repeated BatchItem items = 1; }
message BatchResult {
  string camera_name = 1; RGBRenderReturn result = 2; bool success = 3; string error_message = 4;
}
message BatchRGBRenderReturn { repeated BatchResult items = 1; }
message AggregatedRenderRequest {
  repeated RGBRenderRequest rgb_requests = 1; repeated bytes lidar_requests = 2;
}
message AggregatedRenderReturn {
  repeated RGBRenderReturn rgb_returns = 1; repeated bytes lidar_returns = 2;
  bytes driver_data = 3;
}
message AvailableCamerasRequest { string scene_id = 1; }
message AvailableCamera {
  CameraSpec intrinsics = 1; common.Pose rig_to_camera = 2; string logical_id = 3;
}
message AvailableCamerasReturn { repeated AvailableCamera available_cameras = 1; }
""",
    EGODRIVER: """
message VehicleDefinition {
  repeated nre.grpc.protos.sensorsim.AvailableCamera available_cameras = 3;
}
message RolloutSpec { VehicleDefinition vehicle = 1; }
message SessionDebugInfo { string scene_id = 1; }
message DriveSessionRequest {
  string session_uuid = 1; fixed64 random_seed = 2; SessionDebugInfo debug_info = 4;
  RolloutSpec rollout_spec = 5;
}
message DriveSessionCloseRequest { string session_uuid = 1; }
message CameraImage {
  fixed64 frame_start_us = 2; fixed64 frame_end_us = 3; bytes image_bytes = 4;
  string logical_id = 5;
}
message RolloutCameraImage { string session_uuid = 1; CameraImage camera_image = 3; }
message RolloutEgoTrajectory {
  string session_uuid = 1; common.Trajectory trajectory = 3;
  repeated common.DynamicState dynamic_states = 5;
}
message Route { repeated common.Vec3 waypoints = 1; fixed64 timestamp_us = 2; }
message RouteRequest { string session_uuid = 1; Route route = 3; }
message GroundTruth { common.Trajectory trajectory = 1; fixed64 timestamp_us = 2; }
message GroundTruthRequest { string session_uuid = 1; GroundTruth ground_truth = 2; }
message DriveRequest {
  string session_uuid = 1; fixed64 time_now_us = 3; fixed64 time_query_us = 4;
  bytes renderer_data = 5;
}
message DriveDebugInfo {
  bytes unstructured_debug_info = 1; repeated common.Trajectory sampled_trajectories = 2;
}
message DriveResponse {
  common.Trajectory trajectory = 2; DriveDebugInfo debug_info = 3; bool terminate_session = 4;
}
""",
}
"""Messages by package. Names of messages are unique over all packages."""

Methods = dict[str, tuple[str, str]]
"""Request and reply of each method of a service."""

SENSORSIM_METHODS: Methods = {
    "get_version": ("Empty", "VersionId"),
    "get_available_scenes": ("Empty", "AvailableScenesReturn"),
    "get_available_cameras": ("AvailableCamerasRequest", "AvailableCamerasReturn"),
    "get_available_ego_masks": ("Empty", "AvailableEgoMasksReturn"),
    "render_rgb": ("RGBRenderRequest", "RGBRenderReturn"),
    "batch_render_rgb": ("BatchRGBRenderRequest", "BatchRGBRenderReturn"),
    "render_aggregated": ("AggregatedRenderRequest", "AggregatedRenderReturn"),
}
EGODRIVER_METHODS: Methods = {
    "get_version": ("Empty", "VersionId"),
    "start_session": ("DriveSessionRequest", "SessionRequestStatus"),
    "submit_image_observation": ("RolloutCameraImage", "Empty"),
    "submit_egomotion_observation": ("RolloutEgoTrajectory", "Empty"),
    "submit_route": ("RouteRequest", "Empty"),
    "submit_recording_ground_truth": ("GroundTruthRequest", "Empty"),
    "drive": ("DriveRequest", "DriveResponse"),
    "close_session": ("DriveSessionCloseRequest", "Empty"),
    "shut_down": ("Empty", "Empty"),
}

SENSORSIM_SERVICES = (f"{SENSORSIM}.SensorsimService", "sensorsim.SensorsimService")
"""Paths of the one service: that of AlpaSim and of NuRec up to 26.04, and that of NuRec 26.10."""
EGODRIVER_SERVICE = f"{EGODRIVER}.EgodriverService"

MOST_BYTES = 64 << 20
"""Longest message either way, as in AlpaSim."""
CHANNEL_OPTIONS = (
    ("grpc.max_send_message_length", MOST_BYTES),
    ("grpc.max_receive_message_length", MOST_BYTES),
)
DEADLINE = 300.0
"""Seconds that a call may take, as in AlpaSim."""
PAUSES = (0.5, 2.0)
"""Seconds before each further try of a call whose server is not there, as in AlpaSim."""


@cache
def _classes() -> dict[str, Any]:
    return {
        name.rpartition(".")[2]: kind for name, kind in message_classes(TABLES, "proto3").items()
    }


def message(name: str, **fields: Any) -> Any:
    """A message by its name without package, such as `message("Vec3", x=1.0)`."""
    return _classes()[name](**fields)


def parse(name: str, data: bytes) -> Any:
    """The message of that name that `data` encode; fields that the table lacks are kept.

    Raises:
        google.protobuf.message.DecodeError: they encode none.
    """
    return _classes()[name].FromString(data)
