"""Time and choice: what all windows of a page share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.viewer import ViewedDrive, ViewInputs
from recast.viewer.stage import Playback


def of_steps(*drives: tuple[int, float]) -> Playback:
    """Arms "0", "1", ... of so many steps of so many seconds."""
    arms = {
        str(arm): ViewedDrive(dt, np.arange(steps), None, {}, {})
        for arm, (steps, dt) in enumerate(drives)
    }
    return Playback(ViewInputs("drives", dict.fromkeys(arms), {"only": arms}))


def test_time_goes_on_by_the_speed_and_loops() -> None:
    playback = of_steps((10, 0.1))
    playback.speed = 2.0
    assert not playback.tick(0.2) and playback.step == 0  # it does not play
    playback.play(True)
    assert playback.tick(0.2) and playback.step == 4
    assert not playback.tick(0.01) and playback.step == 4
    playback.tick(0.34)
    assert playback.step == 1 and playback.seconds == pytest.approx(0.1)


def test_steps_stop_it_and_end_at_the_ends() -> None:
    playback = of_steps((5, 0.1))
    playback.play(True)
    playback.by(3)
    assert playback.step == 3 and not playback.playing
    playback.by(3)
    assert playback.step == 4
    playback.by(-10)
    assert playback.step == 0


def test_a_shorter_drive_is_shown_at_its_end() -> None:
    playback = of_steps((50, 0.1), (20, 0.1), (100, 0.05))
    playback.go_to(40)
    playback.select(arm="1")
    assert playback.step == 19
    playback.select(arm="2")
    assert playback.step == 38


def test_another_arm_is_shown_at_the_same_step(inputs: ViewInputs) -> None:
    playback, told = Playback(inputs), []
    playback.subscribe(told.append)
    playback.go_to(5)
    playback.select(arm="replaced")
    assert (playback.arm, playback.step) == ("replaced", 5)
    playback.select(scenario="recording")  # which has no such arm
    assert (playback.arm, playback.shown.scenario) == ("native", "recording")
    assert told == ["step", "drive", "drive"]


def test_listeners_are_told_of_steps_only_when_one_passes(inputs: ViewInputs) -> None:
    playback, told = Playback(inputs), []
    playback.subscribe(told.append)
    playback.play(True)
    assert not playback.tick(0.01) and playback.tick(0.1)
    assert told == ["playing", "step"]


def test_a_new_drive_is_shown_from_its_start_and_given_inputs_stay(
    inputs: ViewInputs, drive: ViewedDrive
) -> None:
    playback = Playback(inputs)
    playback.go_to(3)
    playback.add("mine", "native", replace(drive, events=()))
    assert (playback.scenario, playback.step) == ("mine", 0)
    assert "mine" not in inputs.scenarios
