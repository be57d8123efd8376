"""What is shown just now, and when of it, whoever changes it: shared by all windows of a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from threading import RLock
from typing import Literal

from recast.viewer.inputs import ViewedDrive, ViewInputs
from recast.viewer.stage import Shown

Change = Literal["drive", "step", "playing", "layers"]
"""What changed: scenario or arm, the step, whether it plays, or what is switched on."""


class Playback:
    """Scenario, arm and time, which loops, with those who want to know of changes.

    Args:
        inputs: what there is; scenarios may be added later.

    Attributes:
        speed: seconds of the drive in a second.
        playing: whether time goes on.
        seconds: present time in the drive that is shown, within [0, steps * dt).
    """

    def __init__(self, inputs: ViewInputs) -> None:
        scenarios = {name: dict(arms) for name, arms in inputs.scenarios.items() if arms}
        self._scenarios = scenarios
        self.inputs = replace(inputs, scenarios=scenarios)
        self._lock = RLock()
        self._listeners: list[Callable[[Change], None]] = []
        self.scenario = next(iter(scenarios))
        self.arm = next(iter(scenarios[self.scenario]))
        self.speed, self.playing, self.seconds = 1.0, False, 0.0

    @property
    def drive(self) -> ViewedDrive:
        """The drive that is shown."""
        return self.inputs.scenarios[self.scenario][self.arm]

    @property
    def step(self) -> int:
        """The step that is shown."""
        with self._lock:
            return min(int(self.seconds / self.drive.dt + 1e-6), len(self.drive) - 1)

    @property
    def shown(self) -> Shown:
        """What is shown."""
        with self._lock:
            return Shown(self.scenario, self.arm, self.step)

    @property
    def arms(self) -> tuple[str, ...]:
        """Arms of the scenario that is shown."""
        return tuple(self._scenarios[self.scenario])

    def subscribe(self, listener: Callable[[Change], None]) -> None:
        """Have a function called after each change."""
        self._listeners.append(listener)

    def select(self, scenario: str | None = None, arm: str | None = None) -> None:
        """Show another scenario or arm, at the same time where it has that.

        An arm that the scenario lacks is replaced by its first one.
        """
        with self._lock:
            scenario = self.scenario if scenario is None else scenario
            arms = self._scenarios[scenario]
            wanted = self.arm if arm is None else arm
            self.scenario, self.arm = scenario, wanted if wanted in arms else next(iter(arms))
            self._stand_at(round(self.seconds / self.drive.dt))
        self._tell("drive")

    def add(self, scenario: str, arm: str, drive: ViewedDrive) -> None:
        """Take a drive in, and show it from its start."""
        with self._lock:
            self._scenarios.setdefault(scenario, {})[arm] = drive
            self.seconds = 0.0
        self.select(scenario, arm)

    def go_to(self, step: int) -> None:
        """Show a step; the nearest one there is."""
        with self._lock:
            self._stand_at(step)
        self._tell("step")

    def by(self, steps: int) -> None:
        """Stop, and go on by some steps, or back if they are negative."""
        with self._lock:
            self.playing = False
            self._stand_at(self.step + steps)
        self._tell("playing")
        self._tell("step")

    def play(self, playing: bool) -> None:
        """Let time go on, or stop it."""
        with self._lock:
            self.playing = playing
        self._tell("playing")

    def refresh(self) -> None:
        """Tell that other things than the step shall be shown."""
        self._tell("layers")

    def tick(self, seconds: float) -> bool:
        """Let time pass; whether another step is shown now."""
        with self._lock:
            if not self.playing:
                return False
            before, span = self.step, len(self.drive) * self.drive.dt
            self.seconds = (self.seconds + seconds * self.speed) % span
            moved = self.step != before
        if moved:
            self._tell("step")
        return moved

    def _stand_at(self, step: int) -> None:
        self.seconds = max(0, min(step, len(self.drive) - 1)) * self.drive.dt

    def _tell(self, change: Change) -> None:
        for listener in tuple(self._listeners):
            listener(change)
