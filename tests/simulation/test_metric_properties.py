"""What must hold of every rollout and its metrics, whatever the scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moved_worlds import curved_world, mirrored, mirrored_states, moved

from recast.geometry import se2
from recast.metrics import rollout_metrics
from recast.planning import ConstantVelocity, IdmLaneFollower, LogReplay, Planner
from recast.planning.pdm import PdmClosedPlanner
from recast.simulation import (
    MOTIONS,
    Along,
    Oncoming,
    Rollout,
    RolloutSetup,
    RouteCrossing,
    ScriptedMotion,
    Stationary,
    run_rollout,
)
from support.synthetic_drives import drive

Make = Callable[[], Planner]

STEPS = 40
NEAR = replace(MOTIONS["stationary-a"], min_gap=16.0, braking=20.0, reserve=0.0, lateral=0.4)
MOVED_MOTIONS = st.sampled_from(
    [MOTIONS[name] for name in ("cut-in-a", "advancing-b", "oncoming-through-a")] + [NEAR]
)


def drove(log, planner: Planner, motion: ScriptedMotion, steps: int = STEPS) -> Rollout:
    return run_rollout(RolloutSetup(log, "7", motion, steps=steps), planner)


def values(rollout: Rollout, log) -> dict[str, float]:
    metrics = rollout_metrics(rollout, log.map)
    return {name: metric.value for name, metric in metrics.values.items()} | {
        "cycles": metrics.ttc.per_cycle.tolist(),
        "first": metrics.collision.first_step,
        "off_road": metrics.drivable.first_step,
    }


def assert_same_values(found: dict, expected: dict) -> None:
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, abs=1e-6), name


@settings(max_examples=5, deadline=None)
@given(
    make=st.sampled_from([IdmLaneFollower, ConstantVelocity]),
    motion=MOVED_MOTIONS,
    bend=st.sampled_from([0.004, -0.012]),
    speed=st.floats(5.0, 12.0),
    x=st.floats(-2000, 2000),
    y=st.floats(-2000, 2000),
    turn=st.floats(-3.14, 3.14),
)
def test_metrics_do_not_change_when_the_world_moves(
    make: Make, motion: ScriptedMotion, bend: float, speed: float, x: float, y: float, turn: float
) -> None:
    log = curved_world(speed, bend=bend)
    there = moved(log, (x, y, turn))
    first = drove(log, make(), motion)
    second = drove(there, make(), motion)
    assert_same_values(values(second, there), values(first, log))
    expected = se2.compose((x, y, turn), first.ego[:, :3])
    np.testing.assert_allclose(second.ego[:, :2], expected[:, :2], atol=1e-6)
    np.testing.assert_allclose(second.predictions, first.predictions, atol=1e-6)


def test_metrics_of_pdm_closed_do_not_change_when_the_world_moves() -> None:
    motion = MOTIONS["cut-in-a"]
    log = curved_world()
    there = moved(log, (-713.4, 288.9, 2.1))
    first = drove(log, PdmClosedPlanner(), motion, 15)
    second = drove(there, PdmClosedPlanner(), motion, 15)
    assert_same_values(values(second, there), values(first, log))


def test_the_moved_worlds_hold_all_verdicts() -> None:
    """Otherwise the tests above would compare nothing."""
    log = curved_world()
    hit = values(drove(log, ConstantVelocity(), NEAR), log)
    clear = values(drove(log, IdmLaneFollower(), MOTIONS["advancing-b"]), log)
    assert hit["nc"] == 0.0
    assert hit["ttc"] == 0.0
    assert clear["nc"] == 1.0
    assert clear["dac"] == 1.0
    bent = curved_world(bend=0.012)
    off = values(drove(bent, ConstantVelocity(), MOTIONS["advancing-b"]), bent)
    assert off["dac"] == 0.0


def seen_in_a_mirror(motion: ScriptedMotion) -> ScriptedMotion:
    if isinstance(motion, Stationary):
        return replace(motion, yaw=-motion.yaw, lateral=-motion.lateral)
    if isinstance(motion, Oncoming):
        return replace(motion, lateral=-motion.lateral)
    if isinstance(motion, RouteCrossing | Along):
        offsets = {"begin", "pause_at", "turn_at", "lateral", "to"} & vars(motion).keys()
        there = {name: getattr(motion, name) for name in offsets}
        return replace(motion, **{k: -value for k, value in there.items() if value is not None})
    return motion  # beside the ego is where the next lane lies


def assert_mirrored(log, make: Make, motion: ScriptedMotion, steps: int = STEPS) -> None:
    other = mirrored(log)
    first = drove(log, make(), motion, steps)
    second = drove(other, make(), seen_in_a_mirror(motion), steps)
    for name in ("ego", "actor"):
        found, expected = getattr(second, name).copy(), mirrored_states(getattr(first, name))
        turn = se2.wrap_angle(found[:, 2] - expected[:, 2])
        np.testing.assert_allclose(turn, 0.0, atol=1e-7)
        found[:, 2] = expected[:, 2]
        np.testing.assert_allclose(found, expected, atol=1e-6)
    np.testing.assert_allclose(second.predictions, mirrored_states(first.predictions), atol=1e-6)
    assert_same_values(values(second, other), values(first, log))


@settings(max_examples=5, deadline=None)
@given(
    name=st.sampled_from(sorted(MOTIONS)), speed=st.floats(4.0, 9.0), bend=st.floats(-0.006, 0.006)
)
def test_a_mirrored_scene_gives_the_mirrored_rollout(name: str, speed: float, bend: float) -> None:
    # The road ends where the log does; the farthest motion begins some 60 m ahead.
    log = curved_world(speed, seconds=max(12.0, 90.0 / speed), bend=bend)
    if isinstance(MOTIONS[name], RouteCrossing | Along):  # they begin beside the road
        log = replace(log, tracks={"7": replace(log.tracks["7"], category="pedestrian")})
    assert_mirrored(log, IdmLaneFollower, MOTIONS[name])


@pytest.mark.parametrize("name", ["cut-in-a", "stationary-b"])
def test_a_mirrored_scene_gives_the_mirrored_rollout_of_pdm_closed(name: str) -> None:
    assert_mirrored(curved_world(), PdmClosedPlanner, MOTIONS[name], 15)


FAR = Stationary("far", min_gap=150.0, braking=20.0, reserve=0.0)


@pytest.mark.parametrize("make", [ConstantVelocity, IdmLaneFollower, LogReplay])
@settings(max_examples=3, deadline=None)
@given(speed=st.floats(4.0, 13.0))
def test_a_clear_road_gives_full_marks(make: Make, speed: float) -> None:
    log = drive(speed=speed, seconds=170.0 / speed + 6.0)
    found = values(drove(log, make(), FAR), log)
    assert found["ttc"] == 4.0
    assert found["ttc_constant_velocity"] == 4.0
    assert found["com"] == 1.0
    assert found["com_4_13"] == 1.0
    assert found["nc"] == 1.0


@pytest.mark.parametrize("speed", [6.0, 11.0])
def test_a_clear_road_gives_pdm_closed_full_marks(speed: float) -> None:
    log = curved_world(speed, seconds=190.0 / speed, bend=0.0)
    found = values(drove(log, PdmClosedPlanner(), FAR, 10), log)
    assert found["ttc"] == 4.0
    assert found["com"] == 1.0
    assert found["nc"] == 1.0
    assert found["dac"] == 1.0
