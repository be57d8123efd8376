"""What is shown just now, and when of it, whoever changes it: shared by all windows of a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import RLock
from typing import Literal

from recast.viewer.inputs import Drive, ViewInputs
from recast.viewer.stage import Shown

Change = Literal["drive", "step", "playing", "layers"]
"""What changed: scenario or arm, the step, whether it plays, or what is switched on."""


@dataclass
class Clock:
    """Time of a playback that loops.

    Attributes:
        steps: number of steps, at least 1.
        dt: seconds between steps.
        speed: seconds of the drive in a second.
        playing: whether time goes on.
        seconds: where it stands, within [0, steps dt).
    """

    steps: int
    dt: float
    speed: float = 1.0
    playing: bool = False
    seconds: float = 0.0

    @property
    def step(self) -> int:
        """The step that is shown."""
        return min(int(self.seconds / self.dt + 1e-6), self.steps - 1)

    def go_to(self, step: int) -> None:
        """Stand at a step; the nearest one there is."""
        self.seconds = max(0, min(step, self.steps - 1)) * self.dt

    def by(self, steps: int) -> None:
        """Stop, and go on by some steps, or back if they are negative."""
        self.playing = False
        self.go_to(self.step + steps)

    def advance(self, seconds: float) -> bool:
        """Let time pass; whether another step is shown now."""
        if not self.playing:
            return False
        before = self.step
        self.seconds = (self.seconds + seconds * self.speed) % (self.steps * self.dt)
        return self.step != before

    def load(self, steps: int, dt: float) -> None:
        """Take another drive, at the same time where it has that."""
        now = self.seconds
        self.steps, self.dt = steps, dt
        self.go_to(round(now / dt))


class Playback:
    """Scenario, arm and time, with those who want to know of changes.

    Args:
        inputs: what there is; scenarios may be added later.
    """

    def __init__(self, inputs: ViewInputs) -> None:
        scenarios = {name: dict(arms) for name, arms in inputs.scenarios.items() if arms}
        self._scenarios = scenarios
        self.inputs = replace(inputs, scenarios=scenarios)
        self._lock = RLock()
        self._listeners: list[Callable[[Change], None]] = []
        self.scenario = next(iter(scenarios))
        self.arm = next(iter(scenarios[self.scenario]))
        self.clock = Clock(len(self.drive), self.drive.dt)

    @property
    def drive(self) -> Drive:
        """The drive that is shown."""
        return self.inputs.scenarios[self.scenario][self.arm]

    @property
    def shown(self) -> Shown:
        """What is shown."""
        with self._lock:
            return Shown(self.scenario, self.arm, self.clock.step)

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
            self.clock.load(len(self.drive), self.drive.dt)
        self._tell("drive")

    def add(self, scenario: str, arm: str, drive: Drive) -> None:
        """Take a drive in, and show it from its start."""
        with self._lock:
            self._scenarios.setdefault(scenario, {})[arm] = drive
            self.clock.seconds = 0.0
        self.select(scenario, arm)

    def go_to(self, step: int) -> None:
        """Show a step."""
        with self._lock:
            self.clock.go_to(step)
        self._tell("step")

    def by(self, steps: int) -> None:
        """Stop, and go on by some steps, or back."""
        with self._lock:
            self.clock.by(steps)
        self._tell("playing")
        self._tell("step")

    def play(self, playing: bool) -> None:
        """Let time go on, or stop it."""
        with self._lock:
            self.clock.playing = playing
        self._tell("playing")

    def refresh(self) -> None:
        """Tell that other things than the step shall be shown."""
        self._tell("layers")

    def tick(self, seconds: float) -> bool:
        """Let time pass; whether another step is shown now."""
        with self._lock:
            moved = self.clock.advance(seconds)
        if moved:
            self._tell("step")
        return moved

    def _tell(self, change: Change) -> None:
        for listener in tuple(self._listeners):
            listener(change)
