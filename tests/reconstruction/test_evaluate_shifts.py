"""Views from beside the drive."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recast.geometry import se3
from recast.logs import DrivingLog, Track, Trajectory
from recast.reconstruction import (
    SHIFTS,
    SceneEvaluation,
    ShiftedView,
    TrainResult,
    ViewShift,
    evaluate_scene,
    psnr,
)
from recast.reconstruction.evaluate import held_out_frames, shifted_views
from recast.scene import render_scene
from support.tiny_street import TINY

FRAMES = [("image_02", 3), ("image_02", 11)]


def rig_pose(log: DrivingLog, view: ShiftedView) -> np.ndarray:
    """(4, 4) logged rig from shifted rig."""
    stream = log.cameras[view.camera_name]
    shifted = view.world_from_camera @ se3.inverse(stream.rig_from_camera)
    return se3.inverse(log.world_from_rig.at(view.timestamp_us)) @ shifted


def test_the_ego_moves_to_its_left_and_turns_counter_clockwise(tiny_log: DrivingLog) -> None:
    for view in shifted_views(tiny_log, FRAMES, 1.0, ViewShift(lateral_m=2.0)):
        expected = np.eye(4)
        expected[1, 3] = 2.0
        np.testing.assert_allclose(rig_pose(tiny_log, view), expected, atol=1e-9)
    (view, _) = shifted_views(tiny_log, FRAMES, 0.5, ViewShift(yaw_deg=10.0))
    ahead = rig_pose(tiny_log, view)[:3, 0]
    np.testing.assert_allclose(ahead, [np.cos(np.pi / 18), np.sin(np.pi / 18), 0], atol=1e-9)
    assert (view.camera.width, view.camera.height) == (80, 24)


def test_names() -> None:
    names = [shift.name for shift in SHIFTS]
    assert names[:2] == ["left-1m", "right-1m"] and names[-1] == "turned-right-10deg"
    assert len(set(names)) == len(SHIFTS) == 10
    assert ViewShift(-0.5, 2.5).name == "right-0.5m-turned-left-2.5deg"
    assert ViewShift().name == "logged"


def test_a_camera_inside_a_labelled_box_is_left_out(tiny_log: DrivingLog) -> None:
    left = ViewShift(lateral_m=2.0)
    first, second = shifted_views(tiny_log, FRAMES, 1.0, left)
    span = np.array([first.timestamp_us - 1000, first.timestamp_us + 1000])
    there = Trajectory(span, np.stack([first.world_from_camera] * 2))
    track = Track("beside", "van", np.array([1.0, 1.0, 1.0]), there)
    log = replace(tiny_log, tracks={**tiny_log.tracks, "beside": track})
    (kept,) = shifted_views(log, FRAMES, 1.0, left)
    assert kept.frame == second.frame
    assert len(shifted_views(log, FRAMES, 1.0, ViewShift(lateral_m=-2.0))) == 2


def judged(
    trained: TrainResult, log: DrivingLog, offset: float, out: Path | None = None
) -> SceneEvaluation:
    """Scores against a truth that is brighter than the scene by `offset`."""
    scene = trained.scene

    def truth(views: Sequence[ShiftedView]) -> Iterator[np.ndarray]:
        for view in views:
            logged = se3.inverse(view.world_from_camera)
            pose = scene.corrected_camera(logged, view.camera_name, view.timestamp_us)
            rgb = render_scene(scene, view.camera, pose, scene.actor_poses(view.timestamp_us)).rgb
            yield np.rint(np.clip(0.8 * rgb + offset, 0, 1) * 255).astype(np.uint8)

    shifts = (ViewShift(lateral_m=-1.0), ViewShift(yaw_deg=5.0))
    return evaluate_scene(scene, log, TINY, out, shifts=shifts, truth=truth)


def test_shifted_views_are_scored_against_the_truth(
    trained: TrainResult, tiny_log: DrivingLog, tmp_path: Path
) -> None:
    near, far = judged(trained, tiny_log, 0.1, tmp_path), judged(trained, tiny_log, 0.2)
    assert near.shift_truth
    for scores, worse in zip(near.shifts, far.shifts, strict=True):
        assert [frame.frame for frame in scores.frames] == [3, 11, 19]
        assert scores.whole is not None and worse.whole is not None
        assert scores.whole.psnr > worse.whole.psnr > 5
    record = json.loads((tmp_path / "eval.json").read_text())
    assert record["shift_truth"] and [s["name"] for s in record["shifts"]] == [
        "right-1m",
        "turned-left-5deg",
    ]
    first = record["shifts"][0]
    assert first["lateral_m"] == -1.0 and first["yaw_deg"] == 0.0
    assert first["whole"]["psnr"] == pytest.approx(np.mean([f["psnr"] for f in first["frames"]]))
    assert first["pictures"][0] == "shifts/right-1m/image_02_000003.png"
    picture = np.asarray(Image.open(tmp_path / first["pictures"][0])) / 255.0
    true, rendered, difference = np.split(picture, 3)
    assert psnr(rendered, true) == pytest.approx(first["frames"][0]["psnr"], abs=0.05)
    assert np.abs(difference - np.clip(3 * np.abs(rendered - true), 0, 1)).max() < 0.02


def test_without_truth_there_are_pictures_and_no_figures(
    trained: TrainResult, tiny_log: DrivingLog, tmp_path: Path
) -> None:
    told = []
    result = evaluate_scene(
        trained.scene,
        tiny_log,
        TINY,
        tmp_path,
        shifts=(ViewShift(2.0),),
        progress=lambda done, of: told.append((done, of)),
    )
    (scores,) = result.shifts
    assert scores.frames == () and scores.whole is None and not result.shift_truth
    assert len(scores.pictures) == len(held_out_frames(tiny_log, TINY)) == 3
    camera = tiny_log.cameras["image_02"].camera
    for picture in scores.pictures:
        assert Image.open(tmp_path / picture).size == (camera.width, camera.height)
    record = json.loads((tmp_path / "eval.json").read_text())
    assert record["shifts"][0]["whole"] is None and record["shift_truth"] is False
    assert told == [(i + 1, 6) for i in range(6)]
