"""What the cameras of a rollout saw of the actor, measured from its poses, and its file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from recast.actors.actor import NOTHING, Coverage
from recast.cameras import CameraMount, PinholeCamera
from recast.core.errors import InputError
from recast.geometry import se3
from recast.scene.street_scene import ViewGaps
from recast.simulation.rollout_files import load_coverage, save_coverage
from recast.simulation.scene_renderer import (
    GAPS_EVERY,
    ImageCoverage,
    RolloutCoverage,
    rollout_coverage,
    rollout_gaps,
)
from support.box_world import CAMERA, MOUNTS
from support.made_up_rollouts import make_rollout

SOME = Coverage(40.0, 0.5, 0.25, 0.25)
IMAGES = (
    ImageCoverage("front", 0, True, SOME),
    ImageCoverage("side", 0, False, NOTHING),
    ImageCoverage("front", 5, True, Coverage(120.0, 1.0, 0.0, 0.0)),
    ImageCoverage("side", 5, False, Coverage(80.0, 0.0, 0.0, 1.0)),
    ImageCoverage("front", 10, True, NOTHING),
)


class Recorder:
    """A meter that keeps what it is asked, and sees the actor while it is ahead."""

    def __init__(self) -> None:
        self.calls: list[tuple[PinholeCamera, np.ndarray, Mapping[str, np.ndarray], object]] = []

    def measure(
        self,
        camera: PinholeCamera,
        camera_from_world: np.ndarray,
        poses: Mapping[str, np.ndarray],
        shown: np.ndarray | None = None,
    ) -> Coverage:
        self.calls.append((camera, camera_from_world, dict(poses), shown))
        ahead = (camera_from_world @ poses["7"])[2, 3] > 0
        return SOME if ahead else NOTHING


def test_every_image_at_a_plan_step_is_measured_once() -> None:
    rollout = make_rollout(steps=12)
    seen = np.zeros((CAMERA.height, CAMERA.width), np.bool_)
    bent = replace(CAMERA, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))
    rear = se3.from_rotation_translation(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    mounts = {
        **MOUNTS,
        "virtual": replace(MOUNTS["front"], camera=bent, seen=seen),
        "rear": CameraMount(CAMERA, rear @ MOUNTS["front"].rig_from_camera),
        "unused": MOUNTS["front"],
    }
    meter = Recorder()
    found = rollout_coverage(rollout, meter, mounts, ("front", "rear"), ("virtual", "front"))
    assert [(i.step, i.camera, i.planned) for i in found.images] == [
        (step, name, name != "rear") for step in (0, 5, 10) for name in ("front", "rear", "virtual")
    ]
    assert {i.camera for i in found.images if i.coverage.pixels > 0} == {"front", "virtual"}
    for image, (camera, camera_from_world, poses, shown) in zip(
        found.images, meter.calls, strict=True
    ):
        assert camera == CAMERA
        assert shown is (seen if image.camera == "virtual" else None)
        world_from_camera = (
            rollout.world_from_rig[image.step] @ mounts[image.camera].rig_from_camera
        )
        np.testing.assert_allclose(camera_from_world @ world_from_camera, np.eye(4), atol=1e-12)
        assert set(poses) == {"7"}
        np.testing.assert_array_equal(poses["7"], rollout.world_from_actor[image.step])


class Brightening:
    """A meter of gaps: the more, the farther the camera has come."""

    def measure(
        self,
        camera: PinholeCamera,
        camera_from_world: np.ndarray,
        poses: Mapping[str, np.ndarray],
        usable: np.ndarray | None = None,
    ) -> ViewGaps | None:
        assert camera == CAMERA and set(poses) == {"7"}
        metres = float(se3.inverse(camera_from_world)[0, 3])
        return ViewGaps(metres / 1000, 0.0 if usable is None else 0.5)


class Silent:
    def measure(self, *arguments: object) -> None:
        pass


def test_gaps_are_those_of_the_planners_images() -> None:
    rollout = make_rollout(steps=60)
    seen = np.zeros((CAMERA.height, CAMERA.width), np.bool_)
    mounts = {**MOUNTS, "virtual": replace(MOUNTS["front"], seen=seen)}
    meter: Any = Brightening()
    found = rollout_gaps(rollout, meter, mounts, ("virtual", "front"))
    assert found is not None
    steps = rollout.plan_steps[::GAPS_EVERY]
    places = (rollout.world_from_rig[steps] @ MOUNTS["front"].rig_from_camera)[:, 0, 3]
    assert found.mean.invented == pytest.approx(places.mean() / 1000)
    assert found.mean.empty == pytest.approx(0.25)
    assert found.worst.invented == pytest.approx(places.max() / 1000)
    assert found.worst_s == pytest.approx(steps[places.argmax()] * rollout.dt)
    silent: Any = Silent()
    assert rollout_gaps(rollout, silent, mounts, ("front",)) is None
    assert rollout_gaps(rollout, meter, mounts, ()) is None


def test_means_over_images_and_steps() -> None:
    coverage = RolloutCoverage(IMAGES)
    coverage.validate()
    assert (coverage.visible, coverage.mean.pixels) == (3, 80.0)
    assert coverage.mean.seen == pytest.approx((20 + 120) / 240)
    assert coverage.mean.invented == pytest.approx((10 + 80) / 240)
    given = coverage.of_planner
    assert given is not None and len(given.images) == 3
    assert given.mean == Coverage(80.0, 0.875, 0.0625, 0.0625)
    steps, shares = coverage.by_step()
    assert steps.tolist() == [0, 5]
    np.testing.assert_allclose(shares, [[0.5, 0.25, 0.25], [0.6, 0.0, 0.4]])
    unseen = RolloutCoverage((replace(IMAGES[1], step=0),))
    assert unseen.of_planner is None and unseen.mean == NOTHING
    assert unseen.by_step()[1].shape == (0, 3)


def test_the_file_holds_it_all(tmp_path: Path) -> None:
    coverage = RolloutCoverage(IMAGES)
    for name in ("one", "two"):
        save_coverage(coverage, tmp_path / name)
    assert load_coverage(tmp_path / "one") == coverage
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    save_coverage(RolloutCoverage(()), tmp_path / "none")
    assert load_coverage(tmp_path / "none") == RolloutCoverage(())


@pytest.mark.parametrize(
    ("column", "values", "problem"),
    [
        ("pixels", [0.5, 40.0], "row 0: 0.5 pixels"),
        ("pixels", [-3.0, 40.0], "row 0: -3.0 pixels"),
        ("pixels", [0.0, 40.0], "row 0: shares"),
        ("seen", [1.5, 0.5], "row 0: shares"),
        ("seen", [0.1, 0.5], "row 0: shares"),
        ("seen", [np.nan, 0.5], "column seen, row 0"),
        ("step", [0, -1], "row 1: step -1"),
        ("step", [0.0, 1.0], "not whole numbers"),
        ("camera", [1, 2], "not text"),
    ],
)
def test_what_is_no_coverage_is_refused(
    tmp_path: Path, column: str, values: list[float], problem: str
) -> None:
    path = tmp_path / "coverage.parquet"
    save_coverage(RolloutCoverage(IMAGES[:1] * 2), path)
    table = pq.read_table(path)
    at = table.column_names.index(column)
    pq.write_table(table.set_column(at, column, pa.array(values)), path)
    with pytest.raises(InputError, match=problem) as caught:
        load_coverage(path)
    assert "coverage.parquet" in str(caught.value)
    pq.write_table(table.drop_columns([column]), path)
    with pytest.raises(InputError, match=f"column {column}: is missing"):
        load_coverage(path)


def test_what_is_no_coverage_is_not_written(tmp_path: Path) -> None:
    wrong = RolloutCoverage((replace(IMAGES[0], coverage=Coverage(40.0, 0.5, 0.5, 0.5)),))
    with pytest.raises(ValueError, match="row 0: shares"):
        save_coverage(wrong, tmp_path / "coverage.parquet")
    assert list(tmp_path.iterdir()) == []
