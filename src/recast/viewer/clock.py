"""Where a playback stands."""

from __future__ import annotations

from dataclasses import dataclass


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
