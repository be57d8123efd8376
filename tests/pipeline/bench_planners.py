"""Planners that fail in every way, for the tests of the grid; named module:attribute."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np

from recast.planning import Plan, PlannerInput, PlanningContext
from recast.planning.idm_follower import IdmLaneFollower


class Faulty(IdmLaneFollower):
    """Follows its lane once, and then fails somehow."""

    name = "faulty"
    needs_images = False
    fault = "raise"

    def plan(self, observation: PlannerInput) -> Plan:
        if observation.step < 5:
            return super().plan(observation)
        if self.fault == "raise":
            raise RuntimeError("no idea what to do")
        waypoints = super().plan(observation).waypoints.copy()
        if self.fault == "nan":
            waypoints[3] = np.nan
        return Plan(waypoints[:20] if self.fault == "few" else waypoints)


class NotANumber(Faulty):
    fault = "nan"


class TooFew(Faulty):
    fault = "few"


class Kills(IdmLaneFollower):
    """Ends its process at the third rollout that it is asked for, once."""

    name = "idm-follower"

    def reset(self, context: PlanningContext) -> None:
        super().reset(context)
        marker = Path(os.environ["RECAST_TEST_KILLS"])
        begun = int(marker.read_text()) if marker.exists() else 0
        marker.write_text(str(begun + 1))
        if begun == 2:
            os.kill(os.getpid(), signal.SIGKILL)
