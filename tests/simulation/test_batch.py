from __future__ import annotations

import pytest
from synthetic_drives import drive

from recast.planning import ConstantVelocity, LogReplay, Plan, PlannerInput
from recast.simulation import (
    MOTIONS,
    Rollout,
    RolloutFailure,
    RolloutJob,
    RolloutSetup,
    run_batch,
)


class Failing(ConstantVelocity):
    name = "failing"

    def plan(self, observation: PlannerInput) -> Plan:
        if observation.step == 10:
            raise ZeroDivisionError("no road left")
        return super().plan(observation)


def jobs() -> list[RolloutJob]:
    setup = RolloutSetup(drive(seconds=6), "7", MOTIONS["cut-in-a"], steps=20)
    return [
        RolloutJob(setup, ConstantVelocity()),
        RolloutJob(setup, Failing()),
        RolloutJob(RolloutSetup(drive(seconds=6), "none", MOTIONS["cut-in-b"]), LogReplay()),
        RolloutJob(setup, LogReplay()),
    ]


def test_failures_become_rows_and_the_rest_goes_on() -> None:
    first, failed, refused, last = run_batch(jobs())
    assert isinstance(first, Rollout)
    assert isinstance(last, Rollout)
    assert failed == RolloutFailure(
        name="cut-in-a-native",
        method="native",
        track_id="7",
        motion="cut-in",
        setting="a",
        planner="failing",
        error="ZeroDivisionError",
        reason="no road left",
    )
    assert isinstance(refused, RolloutFailure)
    assert refused.error == "InputError"
    assert "track none: is not in the log" in refused.reason


def test_each_result_is_told_at_once() -> None:
    told: list[tuple[str, str]] = []
    run_batch(jobs(), lambda job, result, timings: told.append((job.planner.name, result.planner)))
    assert told == [(n, n) for n in ("constant-velocity", "failing", "log-replay", "log-replay")]


def test_an_interrupt_ends_the_batch() -> None:
    class Interrupted(ConstantVelocity):
        def plan(self, observation: PlannerInput) -> Plan:
            raise KeyboardInterrupt

    setup = RolloutSetup(drive(seconds=6), "7", MOTIONS["cut-in-a"], steps=20)
    with pytest.raises(KeyboardInterrupt):
        run_batch([RolloutJob(setup, Interrupted())])
