"""What the service answers: images of requests, and one clear status for each that is none."""

from __future__ import annotations

import logging
from contextlib import suppress
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.cameras import Lens, PinholeCamera
from recast.cameras.lenses import fisheye_lens
from recast.geometry import se3
from recast.scene.street_scene import SceneRasterizer
from recast.simulation.scene_renderer import draw_image
from recast_bridges.alpasim.messages import (
    as_sent,
    camera_message,
    message,
    parse,
    pose_message,
    pose_pair,
    read_camera,
    read_middle,
    read_requests,
)
from recast_bridges.alpasim.server import VERSION_ID, SensorsimService
from recast_bridges.rendering import ScenePainter, ServedScene, Unnamed
from recast_bridges.requests import RefusedError
from support.tiny_served import (
    BENT,
    CAMERA,
    MOUNTS,
    MOVING,
    PARKED,
    RIG_FROM_CAMERA,
    SCENE,
    ahead,
    make_log,
    make_scene,
    served,
)

LOG = make_log()
STREET = make_scene(LOG)
RASTERIZER = SceneRasterizer(STREET, "cpu")
POSE = as_sent(ahead(np.array([3.0]), 0.5)[0] @ RIG_FROM_CAMERA)
TIME = 7_000_000
SERVICE = SensorsimService(ScenePainter(served(), "cpu"))
CAR = as_sent(ahead(np.array([14.0]), -1.0)[0])


@pytest.fixture(scope="module")
def service() -> SensorsimService:
    return SERVICE


def request(**changes: Any) -> Any:
    fields = {
        "scene_id": SCENE,
        "resolution_h": CAMERA.height,
        "resolution_w": CAMERA.width,
        "camera_intrinsics": camera_message(CAMERA, "front"),
        "frame_start_us": TIME,
        "frame_end_us": TIME,
        "sensor_pose": pose_pair(POSE),
        "image_format": 4,
        "image_quality": 95.0,
    }
    return message("RGBRenderRequest", **{**fields, **changes})


def ask(service: SensorsimService, method: str, asked: Any, reply: str) -> Any:
    return parse(reply, service.answer(method, asked.SerializeToString()))


def image_of(service: SensorsimService, **changes: Any) -> np.ndarray:
    asked = request(**changes)
    data = ask(service, "render_rgb", asked, "RGBRenderReturn").image_bytes
    planes = np.frombuffer(data, np.uint8).reshape(3, asked.resolution_h, asked.resolution_w)
    return np.moveaxis(planes, 0, -1)


def drawn(camera: PinholeCamera = CAMERA, pose: np.ndarray = POSE, **poses: np.ndarray) -> Any:
    return draw_image(RASTERIZER, camera, se3.inverse(pose), poses, TIME)


def test_what_there_is(service: SensorsimService) -> None:
    nothing = message("Empty")
    version = ask(service, "get_version", nothing, "VersionId")
    assert version.version_id == VERSION_ID and version.grpc_api_version.minor == 54
    scenes = ask(service, "get_available_scenes", nothing, "AvailableScenesReturn")
    assert list(scenes.scene_ids) == [SCENE]
    masks = ask(service, "get_available_ego_masks", nothing, "AvailableEgoMasksReturn")
    assert len(masks.ego_mask_metadata) == 0
    asked = message("AvailableCamerasRequest", scene_id=SCENE)
    cameras = ask(service, "get_available_cameras", asked, "AvailableCamerasReturn")
    for listed, (name, mount) in zip(cameras.available_cameras, MOUNTS.items(), strict=True):
        assert listed.logical_id == listed.intrinsics.logical_id == name
        assert read_camera(listed.intrinsics, "camera") == mount.camera
        rig_from_camera = read_middle(
            message("PosePair", start_pose=listed.rig_to_camera, end_pose=listed.rig_to_camera), ""
        )
        np.testing.assert_allclose(rig_from_camera, RIG_FROM_CAMERA, rtol=0, atol=1e-6)


def test_an_image_is_the_one_drawn_in_process(service: SensorsimService) -> None:
    np.testing.assert_array_equal(image_of(service), drawn())
    assert drawn().std() > 20  # there is something to see


def test_formats(service: SensorsimService) -> None:
    found = {}
    for number in (1, 2):
        asked = request(image_format=number)
        data = ask(service, "render_rgb", asked, "RGBRenderReturn").image_bytes
        found[number] = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
        assert data.startswith(b"\x89PNG" if number == 1 else b"\xff\xd8")
    np.testing.assert_array_equal(found[1], drawn())
    assert np.abs(found[2].astype(int) - drawn()).mean() < 10
    # An unset quality is the one that AlpaSim asks for.
    unset = ask(
        service, "render_rgb", request(image_format=2, image_quality=0.0), "RGBRenderReturn"
    )
    asked = ask(service, "render_rgb", request(image_format=2), "RGBRenderReturn")
    assert unset.image_bytes == asked.image_bytes


def test_intrinsics_are_scaled_to_the_requested_size(service: SensorsimService) -> None:
    found = image_of(service, resolution_h=64, resolution_w=24)
    np.testing.assert_array_equal(found, drawn(CAMERA.resized(24, 64)))


def test_lenses(service: SensorsimService) -> None:
    spec = camera_message(BENT, "bent")
    lens = Lens(BENT)
    wanted = lens.bend(drawn(lens.source))
    found = image_of(service, camera_intrinsics=spec, resolution_h=30, resolution_w=40)
    np.testing.assert_array_equal(found, wanted)
    param = message(
        "OpenCVFisheyeCameraParam", principal_point_x=30.0, principal_point_y=20.0,
        focal_length_x=18.0, focal_length_y=18.0, radial_coeffs=[0.01], max_angle=1.5,
    )  # fmt: skip
    spec = message("CameraSpec", opencv_fisheye_param=param, resolution_h=40, resolution_w=60)
    lens = Lens(fisheye_lens(60, 40, 18.0, 18.0, 30.0, 20.0, (0.01,), 1.5))
    assert len(lens.faces) > 1
    faces = []
    for face in lens.faces:
        turn = se3.from_rotation_translation(face.face_from_lens.T, np.zeros(3))
        faces.append(drawn(face.camera, POSE @ turn))
    found = image_of(service, camera_intrinsics=spec, resolution_h=40, resolution_w=60)
    assert (found[0, 0] == 0).all()  # 1.9 rad from the axis
    differ = found != lens.bend(*faces)
    assert differ.mean() < 0.001  # poses of the faces are multiplied in another order


def test_the_pose_is_that_of_mid_frame(service: SensorsimService) -> None:
    later = as_sent(POSE @ se3.exp([0.4, 0.0, 1.0, 0.0, 0.1, 0.0]))
    pair = message("PosePair", start_pose=pose_message(POSE), end_pose=pose_message(later))
    found = image_of(service, sensor_pose=pair)
    middle = se3.interpolate([0, 2], np.stack([POSE, later]), 1)
    np.testing.assert_array_equal(found, drawn(pose=middle))
    assert (found != drawn()).mean() > 0.3


@pytest.mark.parametrize("unnamed", ["hidden", "logged"])
def test_actors(unnamed: Unnamed) -> None:
    service = SensorsimService(ScenePainter(served(), "cpu", unnamed))
    moved = message("DynamicObject", track_id=MOVING, pose_pair=pose_pair(CAR))
    away = message("DynamicObject", track_id=PARKED, pose_pair=pose_pair(CAR))
    logged = LOG.tracks[MOVING].trajectory.at(TIME)
    others = {} if unnamed == "hidden" else {MOVING: logged}
    # The parked car stands where it is, the moving one is not there, or where the log has it.
    np.testing.assert_array_equal(image_of(service), drawn(**others))
    found = image_of(service, dynamic_objects=[moved])
    np.testing.assert_array_equal(found, drawn(**{MOVING: CAR}))
    found = image_of(service, dynamic_objects=[away])
    np.testing.assert_array_equal(found, drawn(**{**others, PARKED: CAR}))
    assert (drawn(**{MOVING: CAR}) != drawn()).mean() > 0.05
    assert (drawn(**{PARKED: CAR}) != drawn()).mean() > 0.05


def test_a_track_without_a_model_is_told_of_once(
    service: SensorsimService, caplog: pytest.LogCaptureFixture
) -> None:
    stranger = message("DynamicObject", track_id="a bus", pose_pair=pose_pair(CAR))
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            np.testing.assert_array_equal(image_of(service, dynamic_objects=[stranger]), drawn())
    assert [r.getMessage() for r in caplog.records] == [
        f"scene {SCENE} has no model of track 'a bus': the track is not rendered"
    ]


def test_the_local_frame_may_be_another() -> None:
    world_from_local = se3.exp([100.0, -20.0, 3.0, 0.0, 0.0, 0.7])
    scenes = served(world_from_local)
    service = SensorsimService(ScenePainter(scenes, "cpu"))
    local = as_sent(se3.inverse(world_from_local) @ POSE)
    found = image_of(service, sensor_pose=pose_pair(local))
    np.testing.assert_array_equal(found, drawn(pose=world_from_local @ local))


def test_the_ego_pose_is_read_from_both_fields_and_needed_in_neither() -> None:
    rig = as_sent(ahead(np.array([3.0]), 0.5)[0])
    for name in ("ego_pose", "challenge_ego_pose"):
        (found,) = read_requests([request(**{name: pose_pair(rig)})])
        np.testing.assert_array_equal(found.local_from_rig, rig)
    assert read_requests([request()])[0].local_from_rig is None


def test_batches_and_aggregates_keep_their_order(service: SensorsimService) -> None:
    second = request(camera_intrinsics=camera_message(BENT, "bent"))
    items = [
        message("BatchItem", camera_name=name, request=one)
        for name, one in (("b", request()), ("a", second))
    ]
    batch = message("BatchRGBRenderRequest", items=items)
    reply = ask(service, "batch_render_rgb", batch, "BatchRGBRenderReturn")
    assert [(item.camera_name, item.success) for item in reply.items] == [("b", True), ("a", True)]
    both = message("AggregatedRenderRequest", rgb_requests=[request(), second])
    aggregated = ask(service, "render_aggregated", both, "AggregatedRenderReturn")
    images = [one.image_bytes for one in aggregated.rgb_returns]
    assert images == [item.result.image_bytes for item in reply.items]
    assert images[0] == np.moveaxis(drawn(), -1, 0).tobytes() != images[1]


SPEC = camera_message(CAMERA, "front")


def spec(**changes: Any) -> Any:
    found = message("CameraSpec")
    found.CopyFrom(SPEC)
    for name, value in changes.items():
        setattr(found.opencv_pinhole_param, name, value)
    return found


def long_spec() -> Any:
    found = spec()
    found.opencv_pinhole_param.radial_coeffs.append(0.1)
    return found


def windshield() -> Any:
    found = spec()
    found.bivariate_windshield_model_param.SetInParent()
    return found


def two_models() -> Any:
    found = spec()
    found.ftheta_param.SetInParent()
    return found


def far() -> Any:
    pair = pose_pair(POSE)
    pair.end_pose.vec.x = np.inf
    return pair


def unturned() -> Any:
    pair = pose_pair(POSE)
    pair.start_pose.quat.w += 0.5
    return pair


STEEP = message(
    "CameraSpec", resolution_h=32, resolution_w=48,
    ftheta_param=message(
        "FthetaCameraParam", principal_point_x=24.0, principal_point_y=16.0, reference_poly=1,
        pixeldist_to_angle_poly=[0.0, 1e-6, 3e-3], max_angle=1.0,
    ),
)  # fmt: skip
TWICE = [message("DynamicObject", track_id="x", pose_pair=pose_pair(CAR))] * 2
BAD = {
    "scene": ({"scene_id": "nowhere"}, "NOT_FOUND", "'nowhere' is not one of drive"),
    "no size": ({"resolution_h": 0}, "INVALID_ARGUMENT", "resolution_h, resolution_w: 0 x 48"),
    "longer than a JPEG file can be": (
        {"resolution_h": 1, "resolution_w": 65_501, "image_format": 2},
        "INVALID_ARGUMENT",
        "expected 1 to 65500 pixels for each",
    ),
    "size": ({"resolution_h": 1 << 31, "resolution_w": 1 << 31}, "RESOURCE_EXHAUSTED", "pixels"),
    "no camera": ({"camera_intrinsics": None}, "INVALID_ARGUMENT", "camera_intrinsics: is missing"),
    "no model": (
        {"camera_intrinsics": message("CameraSpec")}, "INVALID_ARGUMENT", "has 0 camera models"
    ),
    "two models": ({"camera_intrinsics": two_models()}, "INVALID_ARGUMENT", "has 2 camera models"),
    "windshield": ({"camera_intrinsics": windshield()}, "INVALID_ARGUMENT", "is not supported"),
    "focal": (
        {"camera_intrinsics": spec(focal_length_x=float("nan"))}, "INVALID_ARGUMENT", "fx, fy"
    ),
    "short": (
        {"camera_intrinsics": spec(focal_length_y=1e-300)}, "INVALID_ARGUMENT", "lengths 30"
    ),
    "radial": ({"camera_intrinsics": long_spec()}, "INVALID_ARGUMENT", "radial_coeffs: has 7"),
    "steep": ({"camera_intrinsics": STEEP}, "INVALID_ARGUMENT", "needs pinhole images of over"),
    "no pose": ({"sensor_pose": None}, "INVALID_ARGUMENT", "sensor_pose: is missing"),
    "half a pose": (
        {"sensor_pose": message("PosePair", start_pose=pose_message(POSE))},
        "INVALID_ARGUMENT", "sensor_pose.end_pose: is missing",
    ),
    "far pose": ({"sensor_pose": far()}, "INVALID_ARGUMENT", "end_pose.vec: is not finite"),
    "quaternion": ({"sensor_pose": unturned()}, "INVALID_ARGUMENT", "quat: does not have length 1"),
    "times": ({"frame_end_us": TIME - 1}, "INVALID_ARGUMENT", "is before frame_start_us"),
    "late": ({"frame_end_us": 1 << 63}, "INVALID_ARGUMENT", "is not a time"),
    "mask": ({"insert_ego_mask": True}, "INVALID_ARGUMENT", "recast has no ego masks"),
    "format": ({"image_format": 6}, "INVALID_ARGUMENT", "image_format: is 6"),
    "quality": ({"image_quality": 101.0}, "INVALID_ARGUMENT", "image_quality"),
    "actor twice": ({"dynamic_objects": TWICE}, "INVALID_ARGUMENT", "'x' is named twice"),
    "actor": (
        {"dynamic_objects": [message("DynamicObject", track_id="x")]},
        "INVALID_ARGUMENT", r"dynamic_objects\[0\].pose_pair.start_pose: is missing",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_requests_have_a_clear_status(service: SensorsimService, name: str) -> None:
    changes, code, details = BAD[name]
    data = request(**changes).SerializeToString()
    with pytest.raises(RefusedError, match=details) as refused:
        service.answer("render_rgb", data)
    assert refused.value.code == code


def test_bad_calls_have_a_clear_status(service: SensorsimService) -> None:
    item = message("BatchItem", camera_name="a", request=request())
    twice = message("BatchRGBRenderRequest", items=[item, item])
    lidar = message("AggregatedRenderRequest", lidar_requests=[b""])
    many = message(
        "AggregatedRenderRequest", rgb_requests=[request(resolution_h=3840, resolution_w=2160)] * 5
    )
    for method, data, code, details in (
        ("render_rgb", b"\xff\xff\xff", "INVALID_ARGUMENT", "cannot be read as RGBRenderRequest"),
        ("get_available_cameras", b"", "NOT_FOUND", "scene_id: ''"),
        ("batch_render_rgb", twice.SerializeToString(), "INVALID_ARGUMENT", "twice"),
        ("render_aggregated", lidar.SerializeToString(), "UNIMPLEMENTED", "not render LiDAR"),
        ("render_aggregated", many.SerializeToString(), "RESOURCE_EXHAUSTED", "pixels are"),
    ):  # fmt: skip
        with pytest.raises(RefusedError, match=details) as refused:
            service.answer(method, data)
        assert refused.value.code == code


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 1 << 16), st.integers(0, 255)), min_size=1, max_size=4))
def test_damaged_requests_are_drawn_or_refused(changes: list[tuple[int, int]]) -> None:
    moved = message("DynamicObject", track_id=MOVING, pose_pair=pose_pair(CAR))
    bent = camera_message(BENT, "bent")
    data = bytearray(request(dynamic_objects=[moved], camera_intrinsics=bent).SerializeToString())
    for place, value in changes:
        data[place % len(data)] = value
    with pytest.MonkeyPatch.context() as patch, suppress(RefusedError):
        patch.setattr("recast_bridges.alpasim.messages.MOST_PIXELS", 4096)  # else it takes long
        SERVICE.answer("render_rgb", bytes(data))


def test_nothing_is_drawn_for_a_caller_who_has_gone(service: SensorsimService) -> None:
    with pytest.raises(RefusedError, match="CANCELLED"):
        service.answer("render_rgb", request().SerializeToString(), lambda: False)


def test_a_reply_that_no_message_holds_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recast_bridges.alpasim.server.MOST_BYTES", 5000)
    service = SensorsimService(ScenePainter(served(), "cpu"))
    both = message("AggregatedRenderRequest", rgb_requests=[request(), request()])
    with pytest.raises(RefusedError, match="the images have more than 5000 bytes") as refused:
        service.answer("render_aggregated", both.SerializeToString())
    assert refused.value.code == "RESOURCE_EXHAUSTED"


def test_ftheta_counts_from_the_centre_of_the_first_pixel_unless_told_otherwise() -> None:
    assert read_camera(STEEP, "camera").cx == 24.5
    assert read_camera(STEEP, "camera", ftheta_centre=0.0).cx == 24.0


def test_scenes_are_those_given() -> None:
    scene = ServedScene(STREET, {})
    assert list(ScenePainter({"a": scene, "b": scene}, "cpu").scenes) == ["a", "b"]
