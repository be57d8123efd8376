from __future__ import annotations

from dataclasses import replace

import pytest
from synthetic_drives import drive

from recast.planning import ConstantVelocity, LogReplay, Plan, PlannerInput
from recast.simulation import (
    MOTIONS,
    Rollout,
    RolloutFailure,
    RolloutJob,
    RolloutSetup,
    error_fields,
    run_batch,
)
from recast.simulation.running import TRACEBACK_LIMIT


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
    assert isinstance(failed, RolloutFailure)
    assert "in plan\n" in failed.traceback
    assert failed.traceback.endswith("ZeroDivisionError: no road left\n")
    assert replace(failed, traceback="") == RolloutFailure(
        name="cut-in-a-scene",
        arm="scene",
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


def test_a_traceback_keeps_its_end() -> None:
    fields = error_fields(ValueError("a" * 4000 + "b" * (TRACEBACK_LIMIT - 1)))
    assert fields["traceback"] == "b" * (TRACEBACK_LIMIT - 1) + "\n"
    assert fields["reason"] == "a" * 2000


def test_a_message_is_text_that_every_table_can_hold() -> None:
    fields = error_fields(ValueError("half a character: \ud800, and \0"))
    assert fields["reason"] == "half a character: \\ud800, and \0"
    assert all(value.encode() for value in fields.values())


def test_an_exception_without_a_message_is_a_row_too() -> None:
    class MuteError(Exception):
        def __str__(self) -> str:
            raise RuntimeError("no words")

    fields = error_fields(MuteError())
    assert (fields["error"], fields["reason"]) == (
        "MuteError",
        "its message cannot be read (RuntimeError)",
    )
    assert "MuteError" in fields["traceback"]
