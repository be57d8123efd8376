"""Time and choice: what all windows of a page share."""

from __future__ import annotations

from dataclasses import replace

import pytest

from recast.viewer import Drive, ViewInputs
from recast.viewer.playback import Clock, Playback


def test_time_goes_on_by_the_speed_and_loops() -> None:
    clock = Clock(steps=10, dt=0.1, speed=2.0)
    assert not clock.advance(0.2) and clock.step == 0  # it does not play
    clock.playing = True
    assert clock.advance(0.2) and clock.step == 4
    assert not clock.advance(0.01) and clock.step == 4
    clock.advance(0.34)
    assert clock.step == 1 and clock.seconds == pytest.approx(0.1)


def test_steps_stop_it_and_end_at_the_ends() -> None:
    clock = Clock(steps=5, dt=0.1, playing=True)
    clock.by(3)
    assert clock.step == 3 and not clock.playing
    clock.by(3)
    assert clock.step == 4
    clock.by(-10)
    assert clock.step == 0


def test_a_shorter_drive_is_shown_at_its_end() -> None:
    clock = Clock(steps=50, dt=0.1)
    clock.go_to(40)
    clock.load(steps=20, dt=0.1)
    assert clock.step == 19
    clock.load(steps=100, dt=0.05)
    assert clock.step == 38


def test_another_arm_is_shown_at_the_same_step(inputs: ViewInputs) -> None:
    playback, told = Playback(inputs), []
    playback.subscribe(told.append)
    playback.go_to(5)
    playback.select(arm="replaced")
    assert (playback.arm, playback.clock.step) == ("replaced", 5)
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
    inputs: ViewInputs, drive: Drive
) -> None:
    playback = Playback(inputs)
    playback.go_to(3)
    playback.add("mine", "native", replace(drive, events=()))
    assert (playback.scenario, playback.clock.step) == ("mine", 0)
    assert "mine" not in inputs.scenarios
