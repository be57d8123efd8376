"""Rollouts that fail: the row of a report that says why."""

from __future__ import annotations

from dataclasses import replace

import pytest

from recast.planning import ConstantVelocity, Plan, PlannerInput
from recast.simulation import (
    MOTIONS,
    RolloutFailure,
    RolloutSetup,
    error_fields,
    failure,
    run_rollout,
)
from recast.simulation.running import TRACEBACK_LIMIT
from support.synthetic_drives import drive


class Failing(ConstantVelocity):
    name = "failing"

    def plan(self, observation: PlannerInput) -> Plan:
        if observation.step == 10:
            raise ZeroDivisionError("no road left")
        return super().plan(observation)


def test_a_planner_that_raises_is_a_row() -> None:
    setup = RolloutSetup(drive(seconds=6), "7", MOTIONS["cut-in-a"], steps=20)
    with pytest.raises(ZeroDivisionError) as raised:
        run_rollout(setup, Failing())
    row = failure(setup, "failing", raised.value)
    assert "in plan\n" in row.traceback
    assert row.traceback.endswith("ZeroDivisionError: no road left\n")
    assert replace(row, traceback="") == RolloutFailure(
        name="cut-in-a-scene",
        arm="scene",
        track_id="7",
        motion="cut-in",
        setting="a",
        planner="failing",
        error="ZeroDivisionError",
        reason="no road left",
    )


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
