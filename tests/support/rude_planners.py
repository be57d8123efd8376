"""Planners as users write them, which share memory, end the program, wander off or never answer."""

from __future__ import annotations

import os
import random
import signal
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from recast.planning import ConstantVelocity, Plan, PlannerInput, PlanningContext


class OneArray(ConstantVelocity):
    """Returns the same array each time."""

    name = "one-array"

    def __init__(self) -> None:
        super().__init__()
        self.waypoints = np.zeros((40, 3))

    def plan(self, observation: PlannerInput) -> Plan:
        self.waypoints[:, 0] = (5.0 + 0.1 * observation.step) * 0.1 * np.arange(1, 41)
        return Plan(self.waypoints)


class Drawn(ConstantVelocity):
    """Drives as fast as random numbers of three libraries and the seed of the rollout say."""

    name = "drawn"

    def reset(self, context: PlanningContext) -> None:
        super().reset(context)
        self.rng = np.random.default_rng(context.seed)

    def plan(self, observation: PlannerInput) -> Plan:
        import torch

        drawn = random.random() + np.random.rand()  # noqa: NPY002
        drawn += float(torch.rand(1)) + self.rng.random()
        waypoints = np.zeros((40, 3))
        waypoints[:, 0] = (4.0 + drawn) * 0.1 * np.arange(1, 41)
        return Plan(waypoints)


class Does(ConstantVelocity):
    """Does something in its second plan."""

    name = "does"

    def __init__(self, deed: Callable[[Any, PlannerInput, PlanningContext], object]) -> None:
        super().__init__()
        self.deed = deed

    def reset(self, context: PlanningContext) -> None:
        super().reset(context)
        self.context = context

    def plan(self, observation: PlannerInput) -> Plan:
        if observation.step == 5:
            self.deed(self, observation, self.context)
        return super().plan(observation)


class Moods(Drawn):
    """Drives, never answers or ends its process, as a file says; others say what it did.

    Args:
        folder: folder of the files.
    """

    name = "moods"

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder

    def plan(self, observation: PlannerInput) -> Plan:
        (self.folder / "process").write_text(str(os.getpid()))
        mood = (self.folder / "mood").read_text()
        if mood == "sleep":
            time.sleep(600)
        if mood == "leave":
            os._exit(3)
        return super().plan(observation)

    def finish_rollout(self) -> None:
        (self.folder / "finished").write_text(str(os.getpid()))


def spoil(*_: object) -> None:
    """Change what belongs to the whole process."""
    import torch

    os.chdir("/")
    torch.set_num_threads(2 if torch.get_num_threads() == 1 else 1)
    torch.set_default_dtype(torch.float64)
    torch.set_grad_enabled(False)
    np.seterr(all="raise")
    np.random.seed(1)  # noqa: NPY002
    random.seed(1)
    torch.manual_seed(1)
    warnings.simplefilter("error")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.stdout.close()
    sys.stdout = sys.stderr = None  # type: ignore[assignment]
