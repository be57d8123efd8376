"""Your own planner in a closed loop: python examples/your_planner.py LOG_FOLDER [SCENARIO]."""

import sys

import numpy as np

from recast.logs import read_log
from recast.planning import Plan, PlannerInput, PlanningContext
from recast.simulation import MOTIONS, RolloutSetup, run_rollout


class Careful:
    name, needs_images = "careful", False  # True: `observation.images` is filled

    def reset(self, context: PlanningContext) -> None:
        self.times = context.dt * np.arange(1, 41)

    def plan(self, observation: PlannerInput) -> Plan:
        waypoints = np.zeros((40, 3))  # x forward, y left, heading; 0.1 s apart
        waypoints[:, 0] = 0.8 * observation.ego.vx * self.times
        return Plan(waypoints)


log = read_log(sys.argv[1])
scenario = sys.argv[2] if len(sys.argv) > 2 else "cut-in-a"
rollout = run_rollout(RolloutSetup(log, next(iter(log.tracks)), MOTIONS[scenario]), Careful())
print(f"{rollout.steps_run} steps, from {rollout.ego[0, 3]:.1f} to {rollout.ego[-1, 3]:.1f} m/s")
