"""The Waymo importer on one real frame and one real scenario of the motion dataset."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from google.protobuf import descriptor_pb2, descriptor_pool, message, message_factory

from recast.geometry import boxes, se3
from recast.logs import DrivingLog, read_log
from recast.logs.importers.waymo import load_waymo
from recast.logs.importers.waymo_proto import CAMERA_NAME, decode
from recast.logs.importers.waymo_tfrecord import read_records
from support import proto_writer
from support.importing import import_drive

FRAME_FILE, SCENARIO_FILE = "pvps_data_one_frame.tfrecord", "motion_data_one_scenario.tfrecord"


def _projected_labels() -> type[message.Message]:
    """Frames with the laser labels in the images, as the dataset's makers projected them."""
    file = descriptor_pb2.FileDescriptorProto(name="projected.proto", syntax="proto2")
    kinds = descriptor_pb2.FieldDescriptorProto
    for name, fields in {
        "Box": {"center_x": 1, "center_y": 2, "width": 4, "length": 5},
        "Label": {"box": 1, "id": 4},
        "Camera": {"name": 1, "labels": 2},
        "Frame": {"cameras": 9},
    }.items():
        proto = file.message_type.add(name=name)
        for key, number in fields.items():
            of = {"box": "Box", "labels": "Label", "cameras": "Camera"}.get(key)
            kind = kinds.TYPE_MESSAGE if of else kinds.TYPE_DOUBLE
            kind = {"id": kinds.TYPE_STRING, "name": kinds.TYPE_INT32}.get(key, kind)
            label = kinds.LABEL_REPEATED if key.endswith("s") else kinds.LABEL_OPTIONAL
            proto.field.add(name=key, number=number, type=kind, label=label, type_name=of)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("Frame"))


@pytest.fixture(scope="module")
def waymo(shared: Path) -> Path:
    folder = shared / "data" / "waymo_v1"
    if not folder.is_dir():
        pytest.skip(f"{folder} not found")
    return folder


@pytest.fixture(scope="module")
def log(waymo: Path, tmp_path_factory: pytest.TempPathFactory) -> DrivingLog:
    out = tmp_path_factory.mktemp("waymo") / "log"
    import_drive("waymo", waymo, FRAME_FILE, out)
    return read_log(out)


@pytest.fixture(scope="module")
def scenario(waymo: Path) -> DrivingLog:
    return load_waymo(waymo, SCENARIO_FILE)


def test_real_records_round_trip_bit_by_bit(waymo: Path) -> None:
    for name in (FRAME_FILE, SCENARIO_FILE):
        records = [record.data for record in read_records(waymo / name)]
        # The data's checksum the reader has compared; the writer's slow one would take a second.
        assert len(records) == 1
        stored = (waymo / name).read_bytes()
        assert stored[:12] == proto_writer.record_header(len(records[0]))
        assert stored[12:-4] == records[0]


def test_the_frame_holds_images_calibrations_and_labels(log: DrivingLog, waymo: Path) -> None:
    assert len(log.cameras) == 5 and len(log.tracks) == 75
    assert not log.lidars and log.map is None  # taken out of this file
    for name, stream in log.cameras.items():
        side = name.startswith("SIDE")
        assert stream.images[0].shape == (886 if side else 1280, 1920, 3)
        assert 2000 < stream.camera.fx < 2100 and stream.camera.distortion[1] < -0.2
    categories = [track.category for track in log.tracks.values()]
    counts = {name: categories.count(name) for name in set(categories)}
    assert counts == {"car": 37, "misc": 25, "pedestrian": 12, "cyclist": 1}
    (record,) = read_records(waymo / FRAME_FILE)
    images = decode("Frame", record.data)["images"]
    for image in images:
        stored = log.cameras[image["name"]].images
        assert stored.encoded(0) == (image["image"], "jpeg")  # type: ignore[attr-defined]


def test_projected_boxes_agree_with_the_datasets_own(log: DrivingLog, waymo: Path) -> None:
    (record,) = read_records(waymo / FRAME_FILE)
    errors = []
    for camera in _projected_labels().FromString(record.data).cameras:  # type: ignore[attr-defined]
        name = CAMERA_NAME.names[camera.name]
        stream = log.cameras[name]
        width, height = stream.camera.width, stream.camera.height
        time = int(stream.timestamps_us[0])
        camera_from_world = se3.inverse(log.world_from_rig.at(time) @ stream.rig_from_camera)
        for label in camera.labels:
            track = log.tracks[label.id.removesuffix(f"_{name}")]
            at = camera_from_world @ track.trajectory.at(time)
            corners = boxes.corners(track.size, at)
            pixels, depth = stream.camera.project(corners)
            low, high = pixels.min(axis=0), pixels.max(axis=0)
            if depth.min() < 0.5 or low.min() < 0 or high[0] > width or high[1] > height:
                continue  # the dataset's boxes end at the image's edge
            centre = np.array([label.box.center_x, label.box.center_y])
            half = np.array([label.box.length, label.box.width]) / 2
            errors.append(np.abs(np.concatenate([low - centre + half, high - centre - half])))
    worst = np.array(errors).max(axis=1)
    assert len(errors) > 30
    assert np.mean(errors) < 0.1, np.mean(errors)
    assert worst.max() < 0.5, worst


def test_the_scenarios_map_and_tracks(scenario: DrivingLog) -> None:
    scenario.validate()
    assert len(scenario.tracks) == 82  # less the ego
    assert len(scenario.world_from_rig.timestamps_us) == 91
    assert scenario.map is not None
    scenario.map.validate()
    lanes = scenario.map.lanes
    assert len(lanes) == 197  # of 199: less a bicycle lane and one of a single point
    assert {lane.speed_limit for lane in lanes.values()} > {15 * 0.44704, 45 * 0.44704}
    for lane in lanes.values():
        for other in lane.successors:
            apart = lanes[other].centreline[0] - lane.centreline[-1]
            assert np.linalg.norm(apart) < 0.6
        if lane.left_neighbour is not None:  # where both are nearest, it is to the left
            here, there = lane.centreline[:, :2], lanes[lane.left_neighbour].centreline[:, :2]
            apart = np.linalg.norm(here[:, None] - there, axis=-1)
            i, j = np.unravel_index(np.argmin(apart), apart.shape)
            ahead = np.gradient(here, axis=0)[i]
            x, y = there[j] - here[i]
            assert (ahead[0] * y - ahead[1] * x) / np.linalg.norm(ahead) > -0.1


def test_moving_vehicles_of_the_scenario_keep_to_the_drivable_area(scenario: DrivingLog) -> None:
    assert scenario.map is not None
    area = shapely.union_all([shapely.Polygon(outline) for outline in scenario.map.drivable_area])
    inside = []
    for track in scenario.tracks.values():
        places = track.trajectory.poses[:, :2, 3]
        if track.category == "car" and np.linalg.norm(places[-1] - places[0]) > 5.0:
            inside.append(shapely.contains(area, shapely.points(places)).mean())
    assert len(inside) == 38
    assert np.count_nonzero(np.array(inside) == 1.0) == 37  # one turns into a parking lot
