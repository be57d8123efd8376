"""Drives of logs and rollouts, their moments, and the places from which they are looked at."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import shapely

from recast.geometry import se3
from recast.logs import DrivingLog, HdMap
from recast.metrics import rollout_metrics
from recast.runs import view
from recast.runs.arms import Arm
from recast.scene import StreetScene
from recast.simulation import Rollout
from recast.viewer import ViewedDrive, recording
from recast.viewer.drives import FilmFrames, sampled
from recast.viewer.panels import (
    ABOVE,
    AT_ACTOR,
    BEHIND_EGO,
    first_look,
    first_step,
    look,
    look_names,
)
from recast.viewer.splat_nodes import drivable_mesh, segments


def test_a_recording_has_every_track_where_the_log_has_it(tiny_log: DrivingLog) -> None:
    found = recording(tiny_log)
    track = tiny_log.tracks["0"].trajectory
    present = [track.covers(int(time)) for time in found.times_us]
    assert any(present) and [("0" in found.at(step)) for step in range(len(found))] == present
    step = present.index(True)
    assert np.allclose(found.at(step)["0"], track.at(int(found.times_us[step])))


def test_poses_are_missing_outside_of_a_track(tiny_log: DrivingLog) -> None:
    track = tiny_log.tracks["0"].trajectory
    times = np.array([track.timestamps_us[0] - 1, track.timestamps_us[0]])
    found = sampled(track, times)
    assert np.isnan(found[0]).all() and np.allclose(found[1], track.poses[0])


def test_the_images_of_a_recording_are_the_nearest_in_time(tiny_log: DrivingLog) -> None:
    found, stream = recording(tiny_log), next(iter(tiny_log.cameras.values()))
    film = found.cameras[stream.name].film
    assert film is not None and len(film) == len(found)
    frame = int(np.abs(stream.timestamps_us - found.times_us[7]).argmin())
    assert np.array_equal(film[7], stream.images[frame])


def test_a_rollout_has_its_plans_in_the_world(drive: ViewedDrive, rollout: Rollout) -> None:
    assert [step for step, _ in drive.plans] == rollout.plan_steps.tolist()
    step, points = drive.plans[1]
    local = se3.apply(se3.inverse(rollout.world_from_rig[step]), points)
    assert np.allclose(local[1:, :2], rollout.predictions[1][:, :2])
    assert np.allclose(local[0, :2], 0)


def test_contact_is_a_moment(tiny_log: DrivingLog, tiny_map: HdMap, rollout: Rollout) -> None:
    from recast.viewer.drives import rollout_events

    metrics = rollout_metrics(rollout, tiny_map)
    labels = [event.label for event in rollout_events(rollout, tiny_map)]
    expected = [] if metrics.collision.first_step is None else ["contact"]
    assert [label for label in labels if label == "contact"] == expected
    assert labels[0] == "start" and labels[-1].startswith("end")
    assert sum(label.startswith("plan") for label in labels) == len(rollout.plan_steps)


def test_a_look_through_a_camera_is_that_cameras(drive: ViewedDrive) -> None:
    name = next(iter(drive.cameras))
    assert look_names(drive) == (BEHIND_EGO, AT_ACTOR, ABOVE, name)
    assert drive.rig is not None
    pose = drive.rig[3] @ drive.cameras[name].rig_from_camera
    found = look(drive, name, 3)
    ahead = (found.target - found.eye) / np.linalg.norm(found.target - found.eye)
    assert np.allclose(found.eye, pose[:3, 3]) and np.allclose(ahead, pose[:3, 2])
    assert found.fov == drive.cameras[name].fov


def test_the_page_opens_where_the_camera_that_looks_ahead_is_after_a_second(
    drive: ViewedDrive,
) -> None:
    [(name, front)] = drive.cameras.items()
    half = se3.from_rotation_translation(se3.rotation_z(np.pi), np.zeros(3))
    turned = half @ front.rig_from_camera
    rear = dataclasses.replace(front, rig_from_camera=turned)
    several = dataclasses.replace(drive, cameras={"rear": rear, name: front})
    step = first_step(several)
    assert step == min(round(1.0 / drive.dt), len(drive) - 1) > 0
    assert np.allclose(first_look(several).eye, look(several, name, step).eye)
    assert first_look(dataclasses.replace(drive, cameras={})).fov != front.fov
    assert first_step(dataclasses.replace(drive, rig=None, cameras={})) == 0


def test_the_drivable_area_keeps_its_size(tiny_map: HdMap) -> None:
    vertices, faces = drivable_mesh(tiny_map)
    triangles = shapely.polygons(vertices[faces][..., :2])
    outlines = [*tiny_map.drivable_area, *(lane.polygon for lane in tiny_map.lanes.values())]
    area = shapely.union_all([shapely.make_valid(shapely.Polygon(o)) for o in outlines]).area
    assert shapely.area(triangles).sum() == pytest.approx(area, rel=0.01)


def test_points_that_repeat_make_no_segment() -> None:
    line = np.array([[0.0, 0, 0], [0, 0, 0], [1, 0, 0]])
    assert segments([line, line[:1]]).tolist() == [[[0, 0, 0], [1, 0, 0]]]


def test_wide_pictures_are_kept_small() -> None:
    film = FilmFrames()
    film.add(np.full((100, 960, 3), (200, 100, 50), np.uint8))
    assert film[0].shape == (50, 480, 3)
    assert np.abs(film[5].astype(int) - [200, 100, 50]).max() < 6


def test_an_arm_without_gaussians_of_its_target_shows_the_street_alone(
    scenes: dict[str, StreetScene | None],
) -> None:
    native = scenes["native"]
    arms = {arm.name: arm for arm in (Arm.native(), Arm.oracle("recast"), Arm.empty())}
    shown = view._Scenes(arms, {}, lambda _: native, "0")
    assert {name: list(scene.actors) for name, scene in shown.items() if scene is not None} == {
        "native": ["0"],
        "recast+oracle": [],
        "recast+none": [],
    }
