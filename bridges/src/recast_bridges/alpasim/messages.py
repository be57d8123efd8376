"""Messages of AlpaSim and NuRec, and what their poses, cameras and images are for recast.

Packages common, nre.grpc.protos.sensorsim and egodriver. The wire knows field numbers and types,
not names: nested messages are written side by side here, members of a oneof as plain members, and
message types that recast never looks into as bytes. `alpasim_grpc` may be imported in the same
process: these classes live in a pool of their own. Numbers of poses are float32, quaternions wxyz.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from recast.arrays import Array, Image
from recast.cameras import CameraMount, PinholeCamera, RadialLens, RationalLens
from recast.cameras.lenses import fisheye_lens, ftheta_lens
from recast.core.protos import message_classes
from recast.geometry import se3
from recast.logs import images
from recast.logs.checks import LATEST_US, WORLD_REACH
from recast_bridges.requests import (
    MOST_IN_ALL,
    MOST_PIXELS,
    MOST_SIDE,
    AnyCamera,
    RefusedError,
    RenderRequest,
)

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


_UNIT = 1e-3
"""Farthest that the norm of a quaternion of float32 may be from 1."""


def pose_message(pose: Array) -> Any:
    """The message Pose of `target_from_source` (4, 4)."""
    x, y, z = pose[:3, 3].tolist()
    w, i, j, k = se3.matrix_to_quat(pose[:3, :3]).tolist()
    return message(
        "Pose", vec=message("Vec3", x=x, y=y, z=z), quat=message("Quat", w=w, x=i, y=j, z=k)
    )


def read_pose(pose: Any, where: str) -> Array:
    """`target_from_source` (4, 4) of a message Pose. Raises ValueError: it lacks a part, is not
    finite, is out of this world, or its quaternion is not of length 1."""
    for part in ("vec", "quat"):
        if not pose.HasField(part):
            raise ValueError(f"{where}.{part}: is missing")
    vec = np.array([pose.vec.x, pose.vec.y, pose.vec.z])
    quat = np.array([pose.quat.w, pose.quat.x, pose.quat.y, pose.quat.z])
    if not np.all(np.abs(vec) <= WORLD_REACH):  # also NaN
        raise ValueError(f"{where}.vec: is not finite, or is beyond {WORLD_REACH:g} m")
    if not abs(np.linalg.norm(quat) - 1.0) <= _UNIT:
        raise ValueError(f"{where}.quat: does not have length 1")
    return se3.from_rotation_translation(se3.quat_to_matrix(quat), vec)


def pose_pair(pose: Array) -> Any:
    """The message PosePair of a pose (4, 4) that does not change during the frame."""
    one = pose_message(pose)
    return message("PosePair", start_pose=one, end_pose=one)


def read_middle(pair: Any, where: str) -> Array:
    """The pose (4, 4) halfway between the two of a message PosePair; equal ones stay as they are.
    Raises ValueError: one is missing, or see `read_pose`."""
    for part in ("start_pose", "end_pose"):
        if not pair.HasField(part):
            raise ValueError(f"{where}.{part}: is missing")
    start = read_pose(pair.start_pose, f"{where}.start_pose")
    end = read_pose(pair.end_pose, f"{where}.end_pose")
    if np.array_equal(start, end):
        return start
    return se3.interpolate([0, 2], np.stack([start, end]), 1)


def as_sent(pose: Array) -> Array:
    """What the other side reads of a pose (4, 4): rounded to float32."""
    return read_pose(pose_message(pose), "pose")


FTHETA_CENTRE = 0.5
"""Added to the principal point of f-theta cameras: NVIDIA counts from the centre of the first pixel
in NCore. AlpaSim's messages do not say; 0 takes them as they are."""

_MODELS = ("ftheta_param", "opencv_pinhole_param", "opencv_fisheye_param")
_GLOBAL = 5  # ShutterType


def read_camera(spec: Any, where: str, ftheta_centre: float = FTHETA_CENTRE) -> AnyCamera:
    """The camera of a message CameraSpec, at its native resolution.

    The rational model without k4 to k6 and thin prism is a `PinholeCamera`, as logs have it.

    Raises:
        ValueError: no camera model or several, a value that no camera has, or a windshield, which
            recast does not know.
    """
    named = [name for name in _MODELS if spec.HasField(name)]
    if len(named) != 1:
        raise ValueError(
            f"{where}: has {len(named)} camera models, expected one of {', '.join(_MODELS)}"
        )
    if spec.HasField("bivariate_windshield_model_param"):
        raise ValueError(f"{where}.bivariate_windshield_model_param: is not supported")
    param, size = getattr(spec, named[0]), (spec.resolution_w, spec.resolution_h)
    where = f"{where}.{named[0]}"
    try:
        if named[0] == "opencv_pinhole_param":
            camera = _pinhole(param, size)
        elif named[0] == "opencv_fisheye_param":
            focal = param.focal_length_x, param.focal_length_y
            centre = param.principal_point_x, param.principal_point_y
            camera = fisheye_lens(
                *size, *focal, *centre, tuple(param.radial_coeffs), param.max_angle
            )
        else:
            camera = _ftheta(param, size, ftheta_centre)
        camera.validate()
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    return camera


def _pinhole(param: Any, size: tuple[int, int]) -> AnyCamera:
    radial = _padded(param.radial_coeffs, 6, "radial_coeffs")
    tangential = _padded(param.tangential_coeffs, 2, "tangential_coeffs")
    prism = _padded(param.thin_prism_coeffs, 4, "thin_prism_coeffs")
    focal = param.focal_length_x, param.focal_length_y
    centre = param.principal_point_x, param.principal_point_y
    if any((*radial[3:], *prism)):
        return RationalLens(*size, *focal, *centre, radial, tangential, prism)
    k1, k2, k3, *_ = radial
    return PinholeCamera(*size, *focal, *centre, (k1, k2, *tangential, k3))


def _padded(values: Any, count: int, name: str) -> Any:
    """All coefficients; none at all stand for zeros."""
    if len(values) not in (0, count):
        raise ValueError(f"{name}: has {len(values)} coefficients, expected {count} or none")
    return tuple(values) or (0.0,) * count


def _ftheta(param: Any, size: tuple[int, int], centre: float) -> RadialLens:
    gives = {1: "angle", 2: "distance"}.get(param.reference_poly)
    if gives is None:
        raise ValueError(f"reference_poly: is {param.reference_poly}, not 1 or 2")
    own = param.pixeldist_to_angle_poly if gives == "angle" else param.angle_to_pixeldist_poly
    cde = (1.0, 0.0, 0.0)
    if param.HasField("linear_cde"):
        linear = param.linear_cde
        cde = linear.linear_c, linear.linear_d, linear.linear_e
    x, y = param.principal_point_x + centre, param.principal_point_y + centre
    return ftheta_lens(*size, x, y, tuple(own), gives, param.max_angle, cde)  # type: ignore[arg-type]


def camera_message(camera: PinholeCamera, name: str) -> Any:
    """The message CameraSpec of a pinhole camera, with its distortion and a global shutter."""
    k1, k2, p1, p2, k3 = camera.distortion
    bent = not camera.is_rectified
    param = message(
        "OpenCVPinholeCameraParam",
        principal_point_x=camera.cx,
        principal_point_y=camera.cy,
        focal_length_x=camera.fx,
        focal_length_y=camera.fy,
        radial_coeffs=[k1, k2, k3, 0.0, 0.0, 0.0] if bent else [0.0] * 6,
        tangential_coeffs=[p1, p2],
        thin_prism_coeffs=[0.0] * 4,
    )
    return message(
        "CameraSpec",
        opencv_pinhole_param=param,
        logical_id=name,
        resolution_h=camera.height,
        resolution_w=camera.width,
        shutter_type=_GLOBAL,
    )


def cameras_message(mounts: Mapping[str, CameraMount]) -> Any:
    """The message AvailableCamerasReturn of a rig. Its `rig_to_camera` is `rig_from_camera`."""
    cameras = [
        message(
            "AvailableCamera",
            intrinsics=camera_message(mount.camera, name),
            rig_to_camera=pose_message(mount.rig_from_camera),
            logical_id=name,
        )
        for name, mount in mounts.items()
    ]
    return message("AvailableCamerasReturn", available_cameras=cameras)


PNG, JPEG, PLANAR = 1, 2, 4
"""Numbers of the image formats that recast encodes."""
JPEG_QUALITY = 95
"""Quality of requests that name none, which is what AlpaSim always asks for."""
_SHORTEST = 1e-3
"""Pixels of a focal length in the image asked for: less is a slip, and no number of float32."""


@dataclass(frozen=True, kw_only=True)
class SensorsimRequest(RenderRequest):
    """One image that is asked for, and how it is to be encoded."""

    image_format: int  # `PNG`, `JPEG` or `PLANAR`
    quality: int  # JPEG quality, 1 to 100


def read_requests(
    requests: Sequence[Any], ftheta_centre: float = FTHETA_CENTRE
) -> list[SensorsimRequest]:
    """The images that messages RGBRenderRequest of one call ask for. Raises RefusedError:
    INVALID_ARGUMENT for a bad value, named by its field; RESOURCE_EXHAUSTED for more pixels than
    are drawn in one image or call."""
    pixels = [request.resolution_h * request.resolution_w for request in requests]
    if max(pixels, default=0) > MOST_PIXELS or sum(pixels) > MOST_IN_ALL:
        limits = f"the limit is {MOST_PIXELS} for an image and {MOST_IN_ALL} for a call"
        raise RefusedError("RESOURCE_EXHAUSTED", f"{sum(pixels)} pixels are requested; {limits}")
    try:
        return [_read(request, ftheta_centre) for request in requests]
    except ValueError as error:
        raise RefusedError("INVALID_ARGUMENT", str(error)) from None


def _read(request: Any, ftheta_centre: float) -> SensorsimRequest:
    height, width = request.resolution_h, request.resolution_w
    if not (0 < height <= MOST_SIDE and 0 < width <= MOST_SIDE):
        problem = f"{height} x {width}, expected 1 to {MOST_SIDE} pixels for each"
        raise ValueError(f"resolution_h, resolution_w: {problem}")
    if not request.HasField("camera_intrinsics"):
        raise ValueError("camera_intrinsics: is missing")
    if not request.HasField("sensor_pose"):
        raise ValueError("sensor_pose: is missing")
    start, end = request.frame_start_us, request.frame_end_us
    if end < start:
        raise ValueError(f"frame_end_us: {end} is before frame_start_us, {start}")
    if end >= LATEST_US:
        raise ValueError(f"frame_end_us: {end} is not a time in microseconds since 1970")
    if request.insert_ego_mask:
        raise ValueError("insert_ego_mask: recast has no ego masks")
    if request.image_format not in (PNG, JPEG, PLANAR):
        known = "1 (PNG), 2 (JPEG) or 4 (RGB_UINT8_PLANAR)"
        raise ValueError(f"image_format: is {request.image_format}, expected {known}")
    quality = request.image_quality
    if not 0.0 <= quality <= 100.0:
        raise ValueError(f"image_quality: {quality} is not between 0 and 100")
    poses: dict[str, Array] = {}
    for index, thing in enumerate(request.dynamic_objects):
        where = f"dynamic_objects[{index}]"
        if thing.track_id in poses:
            raise ValueError(f"{where}.track_id: {thing.track_id!r} is named twice")
        poses[thing.track_id] = read_middle(thing.pose_pair, f"{where}.pose_pair")
    rig = next((n for n in ("ego_pose", "challenge_ego_pose") if request.HasField(n)), None)
    camera = read_camera(request.camera_intrinsics, "camera_intrinsics", ftheta_centre)
    camera = camera.resized(width, height)
    camera.validate()
    if min(camera.fx, camera.fy) < _SHORTEST:
        raise ValueError(
            f"camera_intrinsics: focal lengths {camera.fx:g} and {camera.fy:g} pixels are not both "
            f"at least {_SHORTEST:g}"
        )
    return SensorsimRequest(
        scene_id=request.scene_id,
        camera=camera,
        local_from_camera=read_middle(request.sensor_pose, "sensor_pose"),
        timestamp_us=(start + end) // 2,
        poses=poses,
        image_format=request.image_format,
        quality=max(round(quality), 1) if quality else JPEG_QUALITY,
        local_from_rig=None if rig is None else read_middle(getattr(request, rig), "ego_pose"),
    )


def encode(image: Image, image_format: int, quality: int) -> bytes:
    """An image (height, width, 3) uint8 RGB as the bytes of a reply. Raises RefusedError:
    RESOURCE_EXHAUSTED if they are longer than a message."""
    if image_format == PLANAR:
        data = np.moveaxis(image, -1, 0).tobytes()
    else:
        data = images.encode(image, "png" if image_format == PNG else "jpeg", quality)
    if len(data) > MOST_BYTES - 1024:
        raise RefusedError(
            "RESOURCE_EXHAUSTED", f"the image has {len(data)} bytes, too many for a reply"
        )
    return data
