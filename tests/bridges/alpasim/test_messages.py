"""AlpaSim's messages: numbers and types of every field, bytes on the wire, what is not known."""

from __future__ import annotations

import pytest
from google.protobuf import descriptor_pool
from google.protobuf.message import DecodeError

from recast_bridges.alpasim.messages import (
    EGODRIVER_METHODS,
    EGODRIVER_SERVICE,
    SENSORSIM_METHODS,
    SENSORSIM_SERVICES,
    TABLES,
    message,
    parse,
)

# As the protocol has it, written apart from the table that makes the classes: `number:type`, "*"
# for repeated. f float, d double, x fixed64, u uint32, e enumeration, b bool, s string, B bytes.
WIRE = {
    "Empty": "",
    "Vec3": "1:f 2:f 3:f",
    "Quat": "1:f 2:f 3:f 4:f",
    "Pose": "1:Vec3 2:Quat",
    "PoseAtTime": "1:Pose 2:x",
    "StateAtTime": "1:x 2:Pose 3:DynamicState",
    "Trajectory": "1*:PoseAtTime",
    "DynamicState": "1:Vec3 2:Vec3 3:Vec3 4:Vec3",
    "AABB": "1:f 2:f 3:f",
    "ApiVersion": "1:u 2:u 3:u",
    "VersionId": "1:s 2:s 3:ApiVersion",
    "SessionRequestStatus": "",
    "AvailableScenesReturn": "1*:s",
    "LinearCde": "1:d 2:d 3:d",
    "FthetaCameraParam": "1:d 2:d 3:e 4*:d 5*:d 6:d 7:LinearCde",
    "OpenCVPinholeCameraParam": "1:d 2:d 3:d 4:d 5*:d 6*:d 7*:d",
    "OpenCVFisheyeCameraParam": "1:d 2:d 3:d 4:d 5*:d 6:d",
    "WindshieldParam": "1:e 2*:d 3*:d 4*:d 5*:d",
    "CameraSpec": (
        "2:FthetaCameraParam 3:OpenCVPinholeCameraParam 4:OpenCVFisheyeCameraParam 5:s 7:u 8:u 9:e "
        "10:WindshieldParam"
    ),
    "PosePair": "1:Pose 2:Pose",
    "DynamicObject": "1:s 2:PosePair",
    "EgoMaskId": "1:s 2:s",
    "EgoMaskMetadata": "1:EgoMaskId",
    "AvailableEgoMasksReturn": "1*:EgoMaskMetadata",
    "RGBRenderRequest": (
        "1:s 2:u 3:u 4:CameraSpec 5:x 6:x 7:PosePair 8*:DynamicObject 9:e 10:f 11:b 12:EgoMaskId "
        "13:PosePair 1013:PosePair"
    ),
    "RGBRenderReturn": "1:B",
    "BatchItem": "1:s 2:RGBRenderRequest",
    "BatchRGBRenderRequest": "1*:BatchItem",
    "BatchResult": "1:s 2:RGBRenderReturn 3:b 4:s",
    "BatchRGBRenderReturn": "1*:BatchResult",
    "AggregatedRenderRequest": "1*:RGBRenderRequest 2*:B",
    "AggregatedRenderReturn": "1*:RGBRenderReturn 2*:B 3:B",
    "AvailableCamerasRequest": "1:s",
    "AvailableCamera": "1:CameraSpec 2:Pose 3:s",
    "AvailableCamerasReturn": "1*:AvailableCamera",
    "VehicleDefinition": "3*:AvailableCamera",
    "RolloutSpec": "1:VehicleDefinition",
    "SessionDebugInfo": "1:s",
    "DriveSessionRequest": "1:s 2:x 4:SessionDebugInfo 5:RolloutSpec",
    "DriveSessionCloseRequest": "1:s",
    "CameraImage": "2:x 3:x 4:B 5:s",
    "RolloutCameraImage": "1:s 3:CameraImage",
    "RolloutEgoTrajectory": "1:s 3:Trajectory 5*:DynamicState",
    "Route": "1*:Vec3 2:x",
    "RouteRequest": "1:s 3:Route",
    "GroundTruth": "1:Trajectory 2:x",
    "GroundTruthRequest": "1:s 2:GroundTruth",
    "DriveRequest": "1:s 3:x 4:x 5:B",
    "DriveDebugInfo": "1:B 2*:Trajectory",
    "DriveResponse": "2:Trajectory 3:DriveDebugInfo 4:b",
}
_LETTERS = {2: "f", 1: "d", 6: "x", 13: "u", 14: "e", 8: "b", 9: "s", 12: "B"}  # by protobuf's type


@pytest.mark.parametrize("name", WIRE)
def test_fields_have_the_numbers_and_types_of_the_protocol(name: str) -> None:
    found = []
    for field in message(name).DESCRIPTOR.fields:
        kind = field.message_type.name if field.type == 11 else _LETTERS[field.type]
        found.append(f"{field.number}{'*' * field.is_repeated}:{kind}")
    assert " ".join(found) == WIRE[name]


def test_every_message_is_compared() -> None:
    named = sum(text.count("\nmessage ") for text in TABLES.values())
    assert named == len(WIRE)
    for methods in (SENSORSIM_METHODS, EGODRIVER_METHODS):
        assert {name for pair in methods.values() for name in pair} <= set(WIRE)
    assert [path.rpartition(".")[0] for path in SENSORSIM_SERVICES] == [
        "nre.grpc.protos.sensorsim",
        "sensorsim",
    ]


def test_the_driver_s_methods_take_and_give_what_the_protocol_says() -> None:
    wanted = """
    get_version common.Empty common.VersionId
    start_session egodriver.DriveSessionRequest common.SessionRequestStatus
    submit_image_observation egodriver.RolloutCameraImage common.Empty
    submit_egomotion_observation egodriver.RolloutEgoTrajectory common.Empty
    submit_route egodriver.RouteRequest common.Empty
    submit_recording_ground_truth egodriver.GroundTruthRequest common.Empty
    drive egodriver.DriveRequest egodriver.DriveResponse
    close_session egodriver.DriveSessionCloseRequest common.Empty
    shut_down common.Empty common.Empty
    """
    found = {
        method: tuple(message(name).DESCRIPTOR.full_name for name in pair)
        for method, pair in EGODRIVER_METHODS.items()
    }
    lines = (line.split() for line in wanted.split("\n") if line.strip())
    assert found == {method: (request, reply) for method, request, reply in lines}
    assert EGODRIVER_SERVICE == "egodriver.EgodriverService"


def test_packages_are_the_protocols_in_a_pool_of_their_own() -> None:
    names = {message(name).DESCRIPTOR.full_name for name in WIRE}
    assert {"common.Pose", "nre.grpc.protos.sensorsim.CameraSpec", "egodriver.Route"} <= names
    with pytest.raises(KeyError):
        descriptor_pool.Default().FindMessageTypeByName("nre.grpc.protos.sensorsim.CameraSpec")


def test_fields_that_are_not_known_survive() -> None:
    # Field 6 of a CameraSpec (old), 99 of a request: a later version's.
    data = bytes.fromhex("0a01732204300548019a0603666f6f")
    request = parse("RGBRenderRequest", data)
    assert request.scene_id == "s"
    assert request.camera_intrinsics.shutter_type == 1
    assert sorted(request.SerializeToString()) == sorted(data)
    number = parse("RGBRenderRequest", bytes.fromhex("4863")).image_format
    assert number == 99  # of an image format to come


@pytest.mark.parametrize("name", WIRE)
def test_every_message_keeps_a_field_of_a_later_version(name: str) -> None:
    later = "807d058a7d0161"  # numbers 2000 (5) and 2001 ("a")
    assert parse(name, bytes.fromhex(later)).SerializeToString().hex() == later


def test_garbage_is_refused() -> None:
    with pytest.raises(DecodeError):
        parse("RGBRenderRequest", b"\xff\xff\xff\xff")
