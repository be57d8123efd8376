"""Bytes of AlpaSim's messages on the wire, written out by hand from protobuf's encoding.

A tag is 8 times the field's number and its wire type: 0 varint, 1 eight bytes, 2 length and
content, 5 four bytes. Numbers have their lowest byte first; messages in messages are content.
"""

from __future__ import annotations

from typing import Any

import pytest

from recast_bridges.alpasim.messages import TABLES, message, parse

POSE = message("Pose", vec=message("Vec3", x=1.0, z=-2.0), quat=message("Quat", w=1.0))
POSE_HEX = "0a0a0d0000803f1d000000c012050d0000803f"  # vec: x, z; quat: w
PAIR_HEX = f"0a13{POSE_HEX}1213{POSE_HEX}"
SPEC = message(
    "CameraSpec", ftheta_param=message("FthetaCameraParam", reference_poly=1, max_angle=0.5)
)
SPEC_HEX = "120b180131000000000000e03f"
GOLDEN = [
    (POSE, POSE_HEX),
    (
        message("PoseAtTime", pose=POSE, timestamp_us=3),
        f"0a13{POSE_HEX}" "110300000000000000",
    ),
    (
        message("VersionId", version_id="r", grpc_api_version=message("ApiVersion", minor=54)),
        "0a01721a021036",
    ),
    (
        message("AvailableScenesReturn", scene_ids=["a", "b"]),
        "0a01610a0162",
    ),
    (
        message("OpenCVPinholeCameraParam", focal_length_x=1.0, radial_coeffs=[0.0, 2.0]),
        "19000000000000f03f" "2a10" "0000000000000000" "0000000000000040",
    ),
    (SPEC, SPEC_HEX),
    (
        message(
            "RGBRenderRequest", scene_id="s", resolution_h=320, camera_intrinsics=SPEC,
            frame_start_us=1, sensor_pose=message("PosePair", start_pose=POSE, end_pose=POSE),
            image_format=2, image_quality=95.0, challenge_ego_pose=message("PosePair"),
        ),
        f"0a0173" "10c002" f"220d{SPEC_HEX}" "290100000000000000" f"3a2a{PAIR_HEX}" "4802"
        "550000be42" "aa3f00",
    ),
    (
        message(
            "BatchRGBRenderReturn",
            items=[
                message(
                    "BatchResult", camera_name="c", success=True,
                    result=message("RGBRenderReturn", image_bytes=b"\xff"),
                )
            ],
        ),
        "0a0a" "0a0163" "12030a01ff" "1801",
    ),
    (
        message("DriveRequest", session_uuid="u", time_now_us=1, renderer_data=b"d"),
        "0a0175" "190100000000000000" "2a0164",
    ),
    (
        message("DriveResponse", trajectory=message("Trajectory"), terminate_session=True),
        "1200" "2001",
    ),
    (
        message("RouteRequest", route=message("Route", waypoints=[message("Vec3", y=1.0)])),
        "1a07" "0a05150000803f",
    ),
]  # fmt: skip

# Every field of every other message.
F1, F2, F3, FH = "0000803f", "00000040", "00004040", "0000003f"  # float: 1, 2, 3, a half
D1, D2, DH = "000000000000f03f", "0000000000000040", "000000000000e03f"  # double: 1, 2, a half
X1, X2 = "0100000000000000", "0200000000000000"  # fixed64


def some(name: str, hexadecimal: str, **fields: Any) -> tuple[Any, str]:
    """A message and its bytes."""
    return message(name, **fields), hexadecimal


def new(name: str) -> Any:
    """A message without fields: it takes two bytes in another, tag and length 0."""
    return message(name)


GOLDEN += [
    some("Empty", ""),
    some("SessionRequestStatus", ""),
    some("Vec3", f"0d{F1}15{F2}1d{F3}", x=1.0, y=2.0, z=3.0),
    some("Quat", f"0d{F1}15{F2}1d{F3}25{FH}", w=1.0, x=2.0, y=3.0, z=0.5),
    some("AABB", f"0d{F1}15{F2}1d{F3}", size_x=1.0, size_y=2.0, size_z=3.0),
    some(
        "StateAtTime", "090201000000000000" "1200" "1a00",
        timestamp_us=258, pose=new("Pose"), state=new("DynamicState"),
    ),
    some(
        "Trajectory", f"0a0911{X1}" "0a00",
        poses=[message("PoseAtTime", timestamp_us=1), new("PoseAtTime")],
    ),
    some(
        "DynamicState", f"0a050d{F1}" f"120515{F1}" f"1a051d{F1}" "2200",
        angular_velocity=message("Vec3", x=1.0), linear_velocity=message("Vec3", y=1.0),
        linear_acceleration=message("Vec3", z=1.0), angular_acceleration=new("Vec3"),
    ),
    some("ApiVersion", "0801" "10ac02" "1802", major=1, minor=300, patch=2),
    some(
        "VersionId", "0a0172" "120167" "1a00",
        version_id="r", git_hash="g", grpc_api_version=new("ApiVersion"),
    ),
    some("LinearCde", f"09{D1}11{D2}19{DH}", linear_c=1.0, linear_d=2.0, linear_e=0.5),
    some(
        "FthetaCameraParam", f"09{D1}11{D2}" "1802" f"2208{D1}" f"2a10{D2}{DH}" f"31{DH}" "3a00",
        principal_point_x=1.0, principal_point_y=2.0, reference_poly=2,
        pixeldist_to_angle_poly=[1.0], angle_to_pixeldist_poly=[2.0, 0.5], max_angle=0.5,
        linear_cde=new("LinearCde"),
    ),
    some(
        "OpenCVPinholeCameraParam", f"09{D1}11{D2}19{D1}21{D2}" f"2a08{DH}" f"3208{D1}" f"3a08{D2}",
        principal_point_x=1.0, principal_point_y=2.0, focal_length_x=1.0, focal_length_y=2.0,
        radial_coeffs=[0.5], tangential_coeffs=[1.0], thin_prism_coeffs=[2.0],
    ),
    some(
        "OpenCVFisheyeCameraParam", f"09{D1}11{D2}19{D1}21{D2}" f"2a08{DH}" f"31{D1}",
        principal_point_x=1.0, principal_point_y=2.0, focal_length_x=1.0, focal_length_y=2.0,
        radial_coeffs=[0.5], max_angle=1.0,
    ),
    some(
        "WindshieldParam", "0801" f"1208{D1}" f"1a08{D2}" f"2208{DH}" f"2a08{D1}",
        reference_poly=1, horizontal_poly=[1.0], vertical_poly=[2.0],
        horizontal_poly_inverse=[0.5], vertical_poly_inverse=[1.0],
    ),
    some(
        "CameraSpec", "1200" "1a00" "2200" "2a0163" "3801" "4002" "4805" "5200",
        ftheta_param=new("FthetaCameraParam"),
        opencv_pinhole_param=new("OpenCVPinholeCameraParam"),
        opencv_fisheye_param=new("OpenCVFisheyeCameraParam"),
        logical_id="c", resolution_h=1, resolution_w=2, shutter_type=5,
        bivariate_windshield_model_param=new("WindshieldParam"),
    ),
    some("PosePair", "0a00" "1200", start_pose=new("Pose"), end_pose=new("Pose")),
    some("DynamicObject", "0a0174" "1200", track_id="t", pose_pair=new("PosePair")),
    some("EgoMaskId", "0a0163" "120172", camera_logical_id="c", rig_config_id="r"),
    some("EgoMaskMetadata", "0a00", ego_mask_id=new("EgoMaskId")),
    some("AvailableEgoMasksReturn", "0a00", ego_mask_metadata=[new("EgoMaskMetadata")]),
    some(
        "RGBRenderRequest",
        "0a0173" "1001" "1802" "2200" f"29{X1}31{X2}" "3a00" "4200" "4801" f"55{F1}" "5801" "6200"
        "6a00" "aa3f00",
        scene_id="s", resolution_h=1, resolution_w=2, camera_intrinsics=new("CameraSpec"),
        frame_start_us=1, frame_end_us=2, sensor_pose=new("PosePair"),
        dynamic_objects=[new("DynamicObject")], image_format=1, image_quality=1.0,
        insert_ego_mask=True, ego_mask_id=new("EgoMaskId"), ego_pose=new("PosePair"),
        challenge_ego_pose=new("PosePair"),
    ),
    some("RGBRenderReturn", "0a01ff", image_bytes=b"\xff"),
    some("BatchItem", "0a0163" "1200", camera_name="c", request=new("RGBRenderRequest")),
    some("BatchRGBRenderRequest", "0a00" "0a00", items=[new("BatchItem"), new("BatchItem")]),
    some(
        "BatchResult", "0a0163" "1200" "1801" "220165",
        camera_name="c", result=new("RGBRenderReturn"), success=True, error_message="e",
    ),
    some(
        "AggregatedRenderRequest", "0a00" "120101",
        rgb_requests=[new("RGBRenderRequest")], lidar_requests=[b"\x01"],
    ),
    some(
        "AggregatedRenderReturn", "0a00" "1200" "1a0164",
        rgb_returns=[new("RGBRenderReturn")], lidar_returns=[b""], driver_data=b"d",
    ),
    some("AvailableCamerasRequest", "0a0173", scene_id="s"),
    some(
        "AvailableCamera", "0a00" "1200" "1a0163",
        intrinsics=new("CameraSpec"), rig_to_camera=new("Pose"), logical_id="c",
    ),
    some("AvailableCamerasReturn", "0a00", available_cameras=[new("AvailableCamera")]),
    some(
        "VehicleDefinition", "1a03" "1a0163",
        available_cameras=[message("AvailableCamera", logical_id="c")],
    ),
    some("RolloutSpec", "0a00", vehicle=new("VehicleDefinition")),
    some("SessionDebugInfo", "0a0173", scene_id="s"),
    some(
        "DriveSessionRequest", "0a0175" "11ffffffff00000000" "2200" "2a00",
        session_uuid="u", random_seed=2**32 - 1, debug_info=new("SessionDebugInfo"),
        rollout_spec=new("RolloutSpec"),
    ),
    some("DriveSessionCloseRequest", "0a0175", session_uuid="u"),
    some(
        "CameraImage", f"11{X1}19{X2}" "220189" "2a0163",
        frame_start_us=1, frame_end_us=2, image_bytes=b"\x89", logical_id="c",
    ),
    some(
        "RolloutCameraImage", "0a0175" "1a00",
        session_uuid="u", camera_image=new("CameraImage"),
    ),
    some(
        "RolloutEgoTrajectory", "0a0175" "1a00" "2a00" "2a00",
        session_uuid="u", trajectory=new("Trajectory"),
        dynamic_states=[new("DynamicState"), new("DynamicState")],
    ),
    some("Route", f"0a050d{F1}" f"11{X1}", waypoints=[message("Vec3", x=1.0)], timestamp_us=1),
    some("RouteRequest", "0a0175" "1a00", session_uuid="u", route=new("Route")),
    some("GroundTruth", "0a00" f"11{X1}", trajectory=new("Trajectory"), timestamp_us=1),
    some("GroundTruthRequest", "0a0175" "1200", session_uuid="u", ground_truth=new("GroundTruth")),
    some(
        "DriveRequest", "0a0175" f"19{X1}21{X2}" "2a0164",
        session_uuid="u", time_now_us=1, time_query_us=2, renderer_data=b"d",
    ),
    some(
        "DriveDebugInfo", "0a0164" "1200",
        unstructured_debug_info=b"d", sampled_trajectories=[new("Trajectory")],
    ),
    some(
        "DriveResponse", "1200" "1a00" "2001",
        trajectory=new("Trajectory"), debug_info=new("DriveDebugInfo"), terminate_session=True,
    ),
]  # fmt: skip


@pytest.mark.parametrize(("built", "wanted"), GOLDEN, ids=[m.DESCRIPTOR.name for m, _ in GOLDEN])
def test_bytes_on_the_wire(built: Any, wanted: str) -> None:
    assert built.SerializeToString(deterministic=True).hex() == wanted
    assert parse(built.DESCRIPTOR.name, bytes.fromhex(wanted)) == built


def test_every_field_of_every_message_is_among_them() -> None:
    written: dict[str, set[str]] = {}
    for built, _ in GOLDEN:
        fields = written.setdefault(built.DESCRIPTOR.name, set())
        fields |= {field.name for field, _ in built.ListFields()}
    for name, fields in written.items():
        assert fields == {field.name for field in message(name).DESCRIPTOR.fields}, name
    assert len(written) == sum(text.count("\nmessage ") for text in TABLES.values())


def test_a_waypoint_that_is_padding() -> None:
    nan = float("nan")
    padding = message("Route", waypoints=[message("Vec3", x=nan, y=nan, z=nan)])
    assert padding.SerializeToString().hex() == "0a0f0d0000c07f150000c07f1d0000c07f"
