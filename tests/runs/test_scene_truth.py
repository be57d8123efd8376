"""The truth of views beside a synthetic drive, and the tables of an evaluation."""

from __future__ import annotations

from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from recast.logs import DrivingLog
from recast.reconstruction import (
    FrameScore,
    RegionScore,
    SceneEvaluation,
    ShiftedView,
    ShiftScores,
    ViewShift,
    psnr,
)
from recast.reconstruction.evaluate import ShiftedScore
from recast.reconstruction.scores import DepthScore
from recast.runs.display import evaluation_table, shift_table, shifted_truth
from recast.synthetic import is_synthetic
from recast.synthetic.world import World, exposure, make_rig
from recast.synthetic.write import Oracle, OraclePool
from support.small_street import small_world


@pytest.fixture(scope="module")
def world() -> World:
    return small_world()


def beside(world: World, camera: str, shift: ViewShift) -> ShiftedView:
    """A view from the second pose of the drive."""
    mounted = make_rig(96, 64).cameras[camera]
    pose = world.ego.poses[1] @ shift.rig_from_shifted @ mounted.rig_from_camera
    time = int(world.ego.timestamps_us[1])
    return ShiftedView(camera, 1, time, mounted.camera, pose, shift=shift)


def test_shifted_cameras_see_the_world_with_their_own_exposure(world: World) -> None:
    views = [
        beside(world, camera, ViewShift(lateral_m=metres))
        for camera in ("front", "front_left")
        for metres in (0.0, 3.0)
    ]
    with OraclePool(world, workers=1) as pool:
        images = [image / 255 for image in shifted_truth(pool, views)]
    oracle = Oracle(world)
    for view, image in zip(views, images, strict=True):
        frame = oracle.render(
            view.camera,
            view.world_from_camera,
            timestamp_us=view.timestamp_us,
            exposure=exposure(world.seed, view.camera_name),
        )
        assert psnr(image, frame.rgb / 255) > 30
    assert psnr(images[0], images[1]) < 25 and psnr(images[2], images[3]) < 25


def test_only_a_synthetic_log_has_truth(tiny_log: DrivingLog) -> None:
    assert not is_synthetic(tiny_log)
    assert is_synthetic(replace(tiny_log, metadata={"dataset": "synthetic"}))


def shown(evaluation: SceneEvaluation) -> str:
    console = Console(width=110, record=True, file=StringIO())
    console.print(evaluation_table(evaluation))
    if evaluation.shift_truth:
        console.print(shift_table(evaluation))
    return console.export_text()


def test_tables() -> None:
    whole, moving = RegionScore(28.125, 0.9, 0.111), RegionScore(24.0, 0.8, 0.222)
    depth = DepthScore(1234, 0.01, 0.05, 0.25, 0.02, 100.0)
    frame = FrameScore("front", 3, 0, whole, {"7": 23.5}, moving, depth)
    beside = ShiftedScore("front", 3, 0, RegionScore(22.75, 0.7, 0.3), None)
    evaluation = SceneEvaluation(
        (frame,), (ShiftScores(ViewShift(-2.0), (beside, beside), ()),), shift_truth=True
    )
    text = shown(evaluation)
    for line in (
        "whole image 1 28.12 0.900 0.111",
        "moving objects: boxes, l and w x1.5 1 24.00 0.800 0.222",
        "box of track 7 1 23.50",
        "right-2m 2 22.75 0.700 0.300",
    ):
        assert line in " ".join(text.split())
    flat = " ".join(text.split())
    assert "median error 0.050 m, mean 0.25 m, 2.0 %; no surface at 1.0 %" in flat
    plain = replace(frame, whole=RegionScore(28.0, 0.9), moving=None, depth=None)
    without = shown(SceneEvaluation((plain,)))
    assert "LPIPS" not in without and "LiDAR" not in without and "moves" not in without


def test_the_record_is_plain_data() -> None:
    evaluation = SceneEvaluation(
        (FrameScore("front", 3, 0, RegionScore(30.0, 0.9), {}, None, None),)
    )
    record = evaluation.to_json()
    assert record["moving"] is None and record["depth"] is None and record["box_psnr"] is None
    assert record["frames"][0]["psnr"] == 30.0 and np.isfinite(record["psnr"])
