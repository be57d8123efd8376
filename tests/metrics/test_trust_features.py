"""Features of made-up rollouts whose values are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.actors.actor import NOTHING, Coverage
from recast.cameras import box_rectangle
from recast.geometry import se2, se3
from recast.metrics import rollout_metrics
from recast.metrics.trust import FEATURES, GivenCamera, HeldOutFrame, RecordedViews
from recast.metrics.trust.features import SHARES, plan_changes, trust_features
from recast.simulation import Rollout
from recast.simulation.scene_renderer import ImageCoverage, RolloutCoverage
from support.box_world import CAMERA, RIG_FROM_CAMERA, SIZE, box_log
from support.made_up_rollouts import make_rollout, straight_plans

LOG = box_log()
"""Its camera has an image every 10 m along x, and sees the vehicle from behind."""
RECORDED = RecordedViews(LOG, "7")
CAMERAS = (GivenCamera("front", CAMERA.width // 2),)
SPEED, STEPS = 20.0, 30
"""With a plan every 5 steps, each is made where the log has an image."""
WIDTHS = (2.297 + 1.9) / 2
"""Metres between the centres of ego and actor that touch side by side."""


def rollout(
    y: float = 0.0, yaw: float = 0.0, actor_y: float = 10.0, actor_yaw: float = 0.0, ahead=None
) -> Rollout:
    """An ego along x, and an actor at x = 40, or `ahead` metres ahead of it all the time."""
    ego = np.zeros((STEPS + 1, 11))
    ego[:, 0] = SPEED * 0.1 * np.arange(STEPS + 1)
    ego[:, 1], ego[:, 2], ego[:, 3] = y, yaw, SPEED
    actor = np.tile([40.0, actor_y, actor_yaw, 0.0], (STEPS + 1, 1))
    if ahead is not None:
        actor[:, 0] = ego[:, 0] + ahead
    return make_rollout(ego, actor, straight_plans(6, SPEED), actor_size=np.array([4.5, 1.9, 1.6]))


def features(of: Rollout, coverage: RolloutCoverage | None = None, frames=()):
    return trust_features(rollout_metrics(of, None), RECORDED, CAMERAS, coverage, frames)


def shown(step: int, pixels: float, seen: float, mirrored: float, planned: bool = True):
    one = Coverage(pixels, seen, mirrored, 1 - seen - mirrored) if pixels else NOTHING
    return ImageCoverage("front", step, planned, one)


@pytest.mark.parametrize("yaw", [0.0, np.radians(10)])
def test_cameras_beside_the_log(yaw: float) -> None:
    found = features(rollout(y=1.0, yaw=yaw)).values
    ahead = RIG_FROM_CAMERA[0, 3]
    apart = np.hypot(ahead * (1 - np.cos(yaw)), 1.0 + ahead * np.sin(yaw))
    assert found["camera_distance_m"] == pytest.approx(apart, abs=1e-9)
    assert found["camera_angle_deg"] == pytest.approx(np.degrees(yaw), abs=1e-6)


def test_the_plan_that_changed_most() -> None:
    made = rollout()
    plans = made.predictions.copy()
    plans[3:, :, 1] += 2.0  # from the plan of step 15 on, 2 m to the left
    plans[5:, :, 1] += 0.5
    made = replace(made, predictions=plans)
    # Plans of an ego that drives as planned agree at their common times.
    assert plan_changes(made) == pytest.approx([0, 0, 2.0, 0, 0.5], abs=1e-9)
    found = features(made)
    assert (found.changed, found.values["plan_change_m"]) == (15, pytest.approx(2.0, abs=1e-9))


def test_plans_without_a_common_time_do_not_change() -> None:
    made = make_rollout(speed=20.0)
    plans = made.predictions[:3].copy()
    plans[1, :, 1], plans[2, :, 1] = 1.0, 4.0
    few = replace(made, plan_steps=np.array([0, 40, 79]), predictions=plans)
    # The second plan begins where the first ends; the third has one time with the second.
    assert plan_changes(few) == pytest.approx([0.0, 3.0], abs=1e-9)


def test_the_smallest_gap_or_the_speed_of_the_contact() -> None:
    free = features(rollout(y=1.0))
    assert free.values["gap_m"] == pytest.approx(10.0 - 1.0 - WIDTHS, abs=1e-9)
    assert free.values["collision"] == 0.0
    assert "contact_speed_mps" not in free.values
    crossing = rollout(y=1.0, actor_y=2.5, actor_yaw=np.radians(90.0))
    hit = features(crossing)
    assert hit.values["contact_speed_mps"] == pytest.approx(SPEED, abs=1e-9)
    assert hit.values["collision"] == 1.0
    assert hit.closest == rollout_metrics(crossing, None).collision.first_step
    assert {"gap_m", "least_ttc_s"}.isdisjoint(hit.values)
    assert hit.missing["least_ttc_s"] == hit.missing["gap_m"] == "the rollout collides"


def test_the_speed_of_a_contact_is_relative() -> None:
    made = rollout(actor_y=0.0)
    actor = made.actor.copy()
    actor[:, 2:] = np.pi, 3.0  # towards the ego
    metrics = rollout_metrics(replace(made, actor=actor), None)
    assert metrics.contact_speed == pytest.approx(SPEED + 3.0, abs=1e-9)
    assert rollout_metrics(rollout(), None).contact_speed is None


def test_only_plans_before_the_contact_count() -> None:
    made = rollout(actor_y=0.0)
    contact = rollout_metrics(made, None).collision.first_step
    assert contact is not None and 15 < contact <= 20
    plans = made.predictions.copy()
    plans[1:, :, 1] += 1.0
    plans[4:, :, 1] += 5.0  # of step 20, too late
    found = features(
        replace(made, predictions=plans),
        RolloutCoverage((shown(15, 100.0, 1.0, 0.0), shown(20, 900.0, 0.0, 0.0))),
    )
    assert (found.changed, found.values["plan_change_m"]) == (5, pytest.approx(1.0, abs=1e-9))
    assert [found.values[name] for name in SHARES] == [1.0, 0.0, 0.0]


def test_shares_are_weighed_by_the_area_in_the_planners_images() -> None:
    coverage = RolloutCoverage(
        (
            shown(0, 100.0, 0.0, 0.0),
            shown(5, 300.0, 0.5, 0.3),
            shown(5, 9000.0, 1.0, 0.0, planned=False),
            shown(10, 0.0, 0.0, 0.0),
        )
    )
    found = features(rollout(), coverage)
    expected = [150 / 400, 90 / 400, (100 + 60) / 400]
    assert [found.values[name] for name in SHARES] == pytest.approx(expected)
    assert found.values["without_shares"] == 0.0
    assert found.changed == 5
    assert found.coverage == Coverage(300.0, 0.5, 0.3, pytest.approx(0.2))


def test_a_vehicle_without_shares_and_a_street_without_scores_are_named() -> None:
    found = features(rollout())
    assert found.values["without_shares"] == 1.0
    for name in (*SHARES, "held_out_psnr_db", "held_out_ssim"):
        assert name not in found.values
    assert found.missing["invented"] == "the target's shares were not measured"
    assert found.missing["held_out_ssim"] == "the street has no held-out scores"
    assert set(found.values) | set(found.missing) == set(FEATURES)
    hidden = features(rollout(), RolloutCoverage((shown(0, 0.0, 0.0, 0.0),)))
    assert hidden.missing["seen"] == "no image shows the target"


def test_quality_is_that_of_the_nearest_held_out_frames() -> None:
    times = [0, 6_000_000]  # the log is at x = 0, and at 60
    frames = [HeldOutFrame("front", time, 20.0 + i, 0.5 + i / 10) for i, time in enumerate(times)]
    found = features(rollout(), None, frames).values
    # Plans at 0 to 50 m: those up to 30 m are nearest to the first; 30 m is midway.
    assert found["held_out_psnr_db"] == pytest.approx(20.0 + 2 / 6)
    assert found["held_out_ssim"] == pytest.approx(0.5 + 0.2 / 6)
    other = [replace(frames[0], camera="left")]
    assert features(rollout(), None, other).values["held_out_psnr_db"] == 20.0


@pytest.mark.parametrize(("yaw", "side"), [(0.0, "rear"), (np.pi, "front"), (np.pi / 2, "left")])
def test_how_the_vehicle_is_shown(yaw: float, side: str) -> None:
    made = rollout(actor_y=0.0, actor_yaw=yaw, ahead=16.0)
    found = features(made)
    assert found.view is not None and found.view.side == side
    camera_from_actor = se3.inverse(RIG_FROM_CAMERA) @ se2.to_se3(np.array([16.0, 0, yaw]), 0.8)
    rectangle = box_rectangle(np.array([4.5, 1.9, 1.6]), camera_from_actor, CAMERA)
    assert rectangle is not None
    inside = np.clip(rectangle, 0, [CAMERA.width, CAMERA.height] * 2)
    area = (inside[2] - inside[0]) * (inside[3] - inside[1])
    assert found.values["vehicle_px"] == pytest.approx(np.sqrt(area) / 2)  # half the width
    # The log's camera is 12.5 m behind the box centre all the time, the same height above it.
    logged = np.array([-12.5, 0.0, 2.0 - SIZE[2] / 2])
    eye = np.array([-14.5 * np.cos(yaw), 14.5 * np.sin(yaw), 2.0 - 0.8])
    cosine = logged @ eye / np.linalg.norm(logged) / np.linalg.norm(eye)
    expected = np.degrees(np.arccos(cosine))
    assert found.values["view_angle_deg"] == pytest.approx(expected, abs=1e-6)


def test_no_camera_shows_the_vehicle() -> None:
    found = features(rollout(actor_y=0.0, ahead=-30.0))
    assert found.view is None and found.values["vehicle_px"] == 0.0
    assert found.missing["view_angle_deg"] == "no image shows the target"


def test_verdicts_that_noise_flips() -> None:
    hit, missed, longer = (
        rollout_metrics(one, None)
        for one in (rollout(actor_y=0.0), rollout(), rollout(actor_y=0.0, ahead=20.0))
    )
    assert [one.collision.first_step is None for one in (hit, missed, longer)] == [
        False,
        True,
        True,
    ]
    found = trust_features(missed, RECORDED, CAMERAS, None, (), (hit, longer, hit))
    assert found.values["noise_flips"] == pytest.approx(2 / 3)
    assert trust_features(missed, RECORDED, CAMERAS, None, (), (longer,)).values["noise_flips"] == 0
    assert features(rollout()).missing["noise_flips"] == "the arm was not driven with other noise"
    # Over the steps that both have there is no contact yet.
    before = missed.over(hit.collision.first_step - 1)
    assert trust_features(before, RECORDED, CAMERAS, None, (), (hit,)).values["noise_flips"] == 0


def test_no_camera_is_refused() -> None:
    with pytest.raises(ValueError, match="6 plans, 0 cameras"):
        trust_features(rollout_metrics(rollout(), None), RECORDED, (), None, ())
