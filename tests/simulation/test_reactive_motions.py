"""Motions that replay the log, and motions that react."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from recast.core.errors import InputError
from recast.geometry import boxes, se2
from recast.logs.types import DrivingLog
from recast.metrics.driving import constant_velocity_future
from recast.planning import ActorState, ConstantVelocity, IdmLaneFollower, LogReplay, ReferenceRoute
from recast.simulation import (
    MOTIONS,
    Idm,
    MotionInput,
    Rollout,
    RolloutSetup,
    StartSituation,
    prepare,
    run_rollout,
)
from recast.simulation import LoggedMotion as Replay
from recast.simulation.actor_motion import BaseScript
from recast.simulation.history import History, ReactiveActors
from recast.simulation.rollout_start import start_rollout
from support.controlled_tracks import DT, Bad, line, with_track
from support.synthetic_drives import drive


def start_of(log: DrivingLog, key: str, step: int = 0) -> StartSituation:
    route = ReferenceRoute.from_trajectory(log.world_from_rig)
    track = log.tracks[key]
    time = int(log.world_from_rig.timestamps_us[step])
    return StartSituation(
        route,
        1.5 + 10.0 * DT * step,
        10.0,
        5.2,
        track.size,
        track_id=key,
        trajectory=track.trajectory,
        start_timestamp_us=time,
    )


@pytest.mark.parametrize("name", sorted(set(MOTIONS) - {"idm-a", "idm-b"}))
def test_a_step_of_a_scripted_motion_is_its_script(name: str) -> None:
    log = with_track(drive(curvature=0.003), "c", line((15.0, 3.0, 0.1), 8.0))
    situation, motion, ego = start_of(log, "c"), MOTIONS[name], someone(0.0, 0.0)
    script = motion.script(situation, 30, DT)
    state = motion.start(situation)
    np.testing.assert_array_equal(state, script[0])
    for step in range(30):
        state = motion.step(MotionInput(situation, step, 30, state, ego), DT)
        np.testing.assert_array_equal(state, script[step + 1])


def test_replay_is_the_log_and_then_goes_straight_on() -> None:
    bend = np.zeros((41, 3))
    heading = 0.02 * np.arange(41)
    bend[:, 0], bend[:, 1], bend[:, 2] = 40 * np.sin(heading), 40 * (1 - np.cos(heading)), heading
    log = with_track(drive(), "c", bend)
    states = Replay().script(start_of(log, "c"), 60, DT)
    np.testing.assert_allclose(states[:41, :3], bend, atol=1e-9)
    np.testing.assert_allclose(states[:, 3], 8.0, rtol=1e-3)
    moved = np.diff(states[40:, :2], axis=0)
    np.testing.assert_allclose(moved, np.tile(moved[:1], (20, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 0.8, rtol=1e-3)
    np.testing.assert_allclose(states[40:, 2], bend[-1, 2], atol=1e-9)


def test_replay_of_a_drive_is_the_log() -> None:
    log = with_track(drive(), "c", line((12.0, 3.5, 0.0), 9.0))
    rollout = run_rollout(RolloutSetup(log, "c", MOTIONS["log-replay-a"]), LogReplay())
    expected = log.tracks["c"].trajectory.at([rollout.timestamp_us(k) for k in range(0, 161, 40)])
    np.testing.assert_allclose(rollout.actor[::40, :3], se2.from_se3(expected), atol=1e-9)
    assert rollout.reactive == ()


@pytest.mark.parametrize("name", ["log-replay-a", "idm-a"])
def test_who_is_not_labelled_at_the_start_is_refused(name: str) -> None:
    log = with_track(drive(), "c", line((30.0, 3.5, 0.0), 9.0, 50), first=20)
    with pytest.raises(InputError, match=r"track c: is not labelled at the start: .* 2.0 to 6.9 s"):
        prepare(RolloutSetup(log, "c", MOTIONS[name]))


def test_an_actor_that_follows_its_own_path_may_leave_the_ego_s_road() -> None:
    """From behind the ego's start, and across; after the last label the road counts again."""
    log = with_track(drive(), "c", line((-30.0, 8.0, 0.0), 5.0))
    assert (
        run_rollout(RolloutSetup(log, "c", MOTIONS["log-replay-a"]), LogReplay()).steps_run == 160
    )
    short = with_track(drive(), "c", line((-30.0, 8.0, 0.0), 5.2, 31))
    cut = prepare(RolloutSetup(short, "c", MOTIONS["log-replay-a"]))
    assert cut.steps == 33
    assert "the actor would leave the recorded road: it would be 2.1 m from its logged path" in str(
        cut.cut_reason
    )


def someone(x: float, y: float, speed: float = 0.0, heading: float = 0.0) -> ActorState:
    velocity = speed * np.array([np.cos(heading), np.sin(heading)])
    return ActorState("lead", "car", np.array([x, y, heading]), velocity, np.array([4.5, 1.9, 1.6]))


def follow(lead: list[ActorState], motion: Idm, log: DrivingLog) -> NDArray:
    """States of an actor behind a lead, the ego far away."""
    situation, ego = start_of(log, "c"), someone(-100.0, 50.0)
    states = [motion.start(situation)]
    for step, user in enumerate(lead):
        now = MotionInput(situation, step, len(lead), states[-1], ego, (user,))
        states.append(motion.step(now, DT))
    return np.array(states)


@settings(max_examples=12, deadline=None)
@given(
    speed=st.floats(1.0, 12.0),
    gap=st.floats(8.0, 40.0),
    braking=st.floats(1.0, 6.0),  # every lead stands for the last eight seconds
    turn=st.floats(-3.0, 3.0),
)
def test_nobody_who_follows_hits_a_lead_that_brakes(
    speed: float, gap: float, braking: float, turn: float
) -> None:
    """Wherever the world lies: it never overlaps, never reverses, and comes to stand close."""
    move = (50.0, -20.0, turn)
    log = with_track(
        drive(world_from_start=move), "c", se2.compose(move, line((0.0, 5.0, 0.0), speed))
    )
    lead_speed = np.maximum(speed - braking * DT * np.arange(200), 0.0)
    lead_x = 4.25 + gap + np.concatenate([[0.0], np.cumsum(lead_speed[:-1] * DT)])
    places = se2.compose(move, np.stack([lead_x, np.full(200, 5.0), np.zeros(200)], axis=1))
    lead = [
        replace(someone(0, 0, v, turn), pose=pose)
        for pose, v in zip(places, lead_speed, strict=True)
    ]
    states = follow(lead, Idm("a"), log)[1:]
    overlap = boxes.bev_overlap_area(states[:, :3], [4.0, 1.8], places, [4.5, 1.9])
    assert overlap.max() == 0.0
    assert states[:, 3].min() >= 0.0
    assert states[-1, 3] < 0.3
    left = np.linalg.norm(states[-1, :2] - places[-1, :2]) - 4.25
    assert 1.0 < left < 8.0


def test_a_free_road_is_driven_at_the_desired_speed() -> None:
    log = with_track(drive(), "c", line((0.0, 5.0, 0.0), 4.0))
    states = follow([someone(20.0, -5.0)] * 200, Idm("a", speed=0.9), log)
    assert states[0, 3] == pytest.approx(4.0)
    assert states[-1, 3] == pytest.approx(9.0, rel=0.02)
    np.testing.assert_allclose(states[:, 1], 5.0, atol=1e-6)
    moved = np.linalg.norm(np.diff(states[:, :2], axis=0), axis=1)
    np.testing.assert_allclose(moved, states[:-1, 3] * DT, atol=1e-6)


def test_who_stands_does_not_creep() -> None:
    """Also beside a bend, where projecting onto the path is not exact."""
    bend = np.zeros((201, 3))
    heading = 0.01 * np.arange(201)
    bend[:, 0], bend[:, 1], bend[:, 2] = 40 * np.sin(heading), 40 * (1 - np.cos(heading)), heading
    log = with_track(drive(), "c", bend)
    lead = replace(someone(0, 0), pose=bend[10])
    situation = start_of(log, "c")
    states = [np.append(Idm("a").start(situation)[:3], 0.0)]
    for step in range(50):
        now = MotionInput(situation, step, 50, states[-1], someone(-100, 50), (lead,))
        states.append(Idm("a").step(now, DT))
    np.testing.assert_array_equal(np.array(states), np.tile(states[0], (51, 1)))


def test_a_car_that_the_log_saw_standing_drives_straight_on() -> None:
    log = with_track(drive(), "c", line((10.0, 5.0, 0.2), 0.0))
    states = follow([someone(0.0, -50.0)] * 50, Idm("a"), log)
    assert states[0, 3] == 0.0 and states[-1, 3] > 3.0
    np.testing.assert_allclose(states[:, 2], 0.2, atol=1e-9)


def test_a_long_vehicle_across_the_path_is_seen() -> None:
    log = with_track(drive(), "c", line((0.0, 5.0, 0.0), 8.0))
    bus = replace(someone(40.0, 5.0, 0.0, np.pi / 2), size=np.array([12.0, 2.5, 3.0]))
    states = follow([bus] * 150, Idm("a"), log)
    assert states[-1, 3] < 0.2
    assert states[-1, 0] + 2.0 < 40.0 - 1.25


def test_it_reacts_to_the_ego() -> None:
    """The ego stops ahead of it; with an ego that drives on it goes further."""
    log = with_track(drive(), "c", line((-20.0, 0.0, 0.0), 10.0))
    late = {"start_timestamp_us": 5_000_000 + 3_000_000, "steps": 100}

    class Stop(ConstantVelocity):
        def plan(self, observation):
            plan = super().plan(observation)
            return replace(plan, waypoints=0.0 * plan.waypoints)

    stopped = run_rollout(RolloutSetup(log, "c", MOTIONS["idm-a"], **late), Stop())
    free = run_rollout(RolloutSetup(log, "c", MOTIONS["idm-a"], **late), ConstantVelocity())
    assert stopped.reactive == ("c",)
    assert stopped.actor[-1, 3] < 0.3 < 5.0 < free.actor[-1, 3]
    assert touching(stopped) == 0.0 == touching(free)
    again = run_rollout(RolloutSetup(log, "c", MOTIONS["idm-a"], **late), Stop())
    assert again.actor.tobytes() == stopped.actor.tobytes()


def touching(rollout: Rollout) -> float:
    return float(
        boxes.bev_overlap_area(
            rollout.ego_boxes, rollout.ego_size, rollout.actor[:, :3], rollout.actor_size
        ).max()
    )


def test_at_the_end_of_the_road_it_cuts_as_a_script_does() -> None:
    setup = RolloutSetup(drive(speed=5.0, seconds=20), "7", Idm("fast", speed=2.0, gap=30.0))
    rollout = run_rollout(setup, IdmLaneFollower())
    assert rollout.steps_run < 160
    assert "the actor would leave the recorded road: it would be at" in str(rollout.cut_reason)
    length = 5.0 * 20
    assert rollout.actor[-1, 0] <= length - 2.0 < rollout.actor[-1, 0] + rollout.actor[-1, 3] * DT
    assert len(rollout.ego) == len(rollout.actor) == len(rollout.world_from_actor)
    preview = prepare(setup)
    assert preview.cut_reason == rollout.cut_reason
    assert preview.steps == rollout.steps_run


def test_an_actor_that_reacts_moves_with_the_world() -> None:
    moved = (120.0, -40.0, 2.0)
    here, there = (
        run_rollout(
            RolloutSetup(
                drive(curvature=0.005, world_from_start=pose), "7", MOTIONS["idm-b"], steps=80
            ),
            IdmLaneFollower(),
        )
        for pose in ((0.0, 0.0, 0.0), moved)
    )
    expected = se2.compose(moved, here.actor[:, :3])
    np.testing.assert_allclose(there.actor[:, :2], expected[:, :2], atol=1e-4)
    np.testing.assert_allclose(there.actor[:, 3], here.actor[:, 3], atol=1e-4)


@pytest.mark.parametrize("at", [0, 7])
@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.array([1.0, np.nan, 0.0, 0.0]), r"is \[1.0, nan, 0.0, 0.0\]"),
        (np.zeros(3), r"is float64 \(3,\), not numbers \(4,\)"),
        (np.array([30.0, 0.0, 0.0, -2.0]), "has the negative speed -2"),
        (None, "is None, not numbers"),
        ([[1.0], [1.0, 2.0]], r"is \[\[1.0\], \[1.0, 2.0\]\], not numbers"),
        ("abcd", "is 'abcd', not numbers"),
        (np.array([1e300, 0.0, 0.0, 0.0]), r"is \[1e\+300, 0.0"),
    ],
)
def test_a_motion_that_returns_no_state_is_one_line(value: object, message: str, at: int) -> None:
    setup = RolloutSetup(drive(), "7", Bad(value, at), steps=20)  # type: ignore[arg-type]
    match = rf"motion bad: its state {at} {message}"
    with pytest.raises(InputError, match=match) as error:
        run_rollout(setup, ConstantVelocity())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"lateral": 1.0}, "lateral: is an offset from the ego's route; give gap as well"),
        ({"speed": 0.0}, "speed: is 0.0; give more than 0"),
        ({"speed": float("nan")}, "speed: is nan; give more than 0"),
        ({"min_gap": -1.0}, "min_gap: is -1.0; give more than 0"),
        ({"headway": -1.0}, "headway: is -1.0; give 0 or more"),
    ],
)
def test_parameters_out_of_range(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Idm("a", **arguments)


@dataclass(frozen=True)
class Moving(BaseScript):
    """Moves at 4 m/s by another angle than it faces."""

    angle: float
    setting: str = "a"
    name: str = "moving"

    def script(self, start: StartSituation, steps: int, dt: float) -> NDArray:
        states = np.zeros((steps + 1, 4))
        states[:, 0], states[:, 1], states[:, 3] = 60.0, 6.0, 4.0
        along = 4.0 * dt * np.arange(steps + 1)
        states[:, :2] += along[:, None] * [np.cos(self.angle), np.sin(self.angle)]
        states[7, 2] = np.pi - 0.01  # a label that is turned around
        return states


@pytest.mark.parametrize("angle", [0.0, np.pi, np.pi / 2])
def test_velocities_are_those_of_the_motion_whatever_the_heading(angle: float) -> None:
    seen: list[NDArray] = []

    class Watching(ConstantVelocity):
        def plan(self, observation):  # type: ignore[no-untyped-def]
            seen.append(observation.actors[0].velocity)
            return super().plan(observation)

    setup = RolloutSetup(drive(), "7", Moving(angle), steps=20, plan_every=1)
    rollout = run_rollout(setup, Watching())
    wanted = 4.0 * np.array([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(seen, np.tile(wanted, (20, 1)), atol=1e-9)
    future = constant_velocity_future(rollout.actor, [3], DT)[0]
    np.testing.assert_allclose((future[1] - future[0])[:2] / DT, wanted, atol=1e-9)


def test_reacting_actors_project_the_road_users_once_each(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    project = ReferenceRoute.project

    def counted(self: ReferenceRoute, *points: object) -> object:
        calls.append(points)
        return project(self, *points)

    log = drive()
    for number in range(8):
        log = with_track(log, f"c{number}", line((20.0 + 12.0 * number, 3.5, 0.0), 5.0))
    others = {f"c{number}": Idm("a") for number in range(1, 8)}
    setup = RolloutSetup(log, "c0", Idm("a"), steps=10, actors=others)
    start = start_rollout(setup)
    actors = ReactiveActors(setup, start, History(setup, start))
    monkeypatch.setattr(ReferenceRoute, "project", counted)
    actors.step()
    own = [one for one in calls if np.shape(one[0])[-2:] == (9, 2)]
    assert len(own) == 8 and np.shape(own[0][0]) == (9, 9, 2)
