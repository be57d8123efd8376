"""Which images count: by box, distance and what hides the box, never by what an arm draws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.geometry import boxes
from recast.logs import DrivingLog
from recast.metrics.scene_level_images import (
    FrameRule,
    LoggedFrame,
    RolloutFrame,
    logged_frames,
    shown_frames,
    spread_over_azimuth,
    visible_share,
)
from recast.simulation import camera_mounts

SIZE = np.array([4.5, 1.8, 1.5])
CAMERA = PinholeCamera(480, 320, 300.0, 300.0, 240.0, 160.0)


def ahead(distance: float, aside: float = 0.0) -> np.ndarray:
    """camera_from_actor of a vehicle straight ahead, driving away."""
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    pose[:3, 3] = [aside, 0.5, distance]
    return pose


def test_the_box_must_be_near_enough_large_enough_and_half_in_the_image() -> None:
    rule = FrameRule()
    assert rule.rectangle(SIZE, ahead(10.0), CAMERA) is not None
    assert rule.rectangle(SIZE, ahead(2.5), CAMERA) is None
    assert rule.rectangle(SIZE, ahead(61.0), CAMERA) is None
    assert rule.rectangle(SIZE, ahead(20.0), CAMERA) is None  # 22 pixels high
    assert FrameRule(least_px=16).rectangle(SIZE, ahead(20.0), CAMERA) is not None
    assert rule.rectangle(SIZE, ahead(8.0, 9.0), CAMERA) is None  # mostly beside the image


def test_what_stands_before_the_box_hides_it() -> None:
    wall = np.full((320, 480), 100.0, np.float32)
    assert visible_share(wall, SIZE, ahead(10.0), CAMERA) == 1.0
    assert visible_share(np.full_like(wall, 5.0), SIZE, ahead(10.0), CAMERA) == 0.0
    assert visible_share(np.full_like(wall, np.inf), SIZE, ahead(10.0), CAMERA) == 1.0
    half = wall.copy()
    half[:, :240] = 1.0  # a post before the left half
    assert 0.4 <= visible_share(half, SIZE, ahead(10.0), CAMERA) <= 0.6


@given(st.floats(5, 50), st.floats(-20, 20), st.floats(1, 60))
def test_a_nearer_wall_never_shows_more(distance: float, aside: float, wall: float) -> None:
    pose = ahead(distance, aside)
    near, far = (np.full((320, 480), depth, np.float32) for depth in (wall, wall + 5))
    shares = [visible_share(one, SIZE, pose, CAMERA) for one in (near, far)]
    assert 0.0 <= shares[0] <= shares[1] <= 1.0


def test_the_lattice_lies_in_the_box() -> None:
    points = boxes.lattice(SIZE, ahead(10.0, 2.0))
    assert points.shape == (125, 3)
    assert boxes.contains(points, SIZE, ahead(10.0, 2.0)).all()
    assert not boxes.contains(points, 0.85 * SIZE, ahead(10.0, 2.0)).all()


def test_logged_images_with_the_vehicle_count(tiny_log: DrivingLog) -> None:
    cameras = [(name, mount.camera) for name, mount in camera_mounts(tiny_log).items()]
    found = list(logged_frames(tiny_log, "0", cameras, FrameRule(least_px=8)))
    assert found
    for one in found:
        left, top, right, bottom = one.rectangle
        assert min(right - left, bottom - top) >= 8
        assert tiny_log.cameras[one.camera].timestamps_us[one.frame] == one.timestamp_us
    assert not list(logged_frames(tiny_log, "0", cameras, FrameRule(least_px=10_000)))


def frame(azimuth: float) -> LoggedFrame:
    return LoggedFrame("front", 0, 0, (0, 0, 9, 9), azimuth)


def test_references_are_spread_over_the_views_of_the_vehicle() -> None:
    rear = [frame(np.pi + 0.01 * i) for i in range(20)]
    chosen = spread_over_azimuth([*rear, frame(0.0), frame(np.pi / 2)], 3)
    assert chosen == [0, 20, 21]
    assert spread_over_azimuth(rear[:3], 16) == [0, 1, 2]
    assert spread_over_azimuth([], 16) == []


@given(st.lists(st.floats(-np.pi, np.pi), max_size=40), st.integers(1, 20))
def test_references_are_distinct_and_as_many_as_asked(angles: list[float], most: int) -> None:
    chosen = spread_over_azimuth([frame(angle) for angle in angles], most)
    assert len(set(chosen)) == len(chosen) == min(most, len(angles))
    assert chosen == sorted(chosen)


def test_the_figure_shows_the_largest_of_each_motion_and_setting() -> None:
    frames = tuple(
        RolloutFrame(motion, setting, step, "front", (0, 0, side, 10))
        for motion, setting, step, side in (
            ("cut-in", "a", 0, 20),
            ("cut-in", "a", 5, 40),
            ("cut-in", "b", 0, 30),
            ("oncoming", "a", 0, 10),
            ("oncoming", "a", 5, 10),
        )
    )
    assert shown_frames(frames) == (1, 2, 3)


@pytest.mark.parametrize(
    ("rule", "option"), [(FrameRule(every=0), "`every`"), (FrameRule(least_px=1), "`least_px`")]
)
def test_rules_out_of_range_are_refused(rule: FrameRule, option: str) -> None:
    with pytest.raises(InputError, match=option):
        rule.validate()
