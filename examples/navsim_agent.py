"""A NAVSIM agent in a closed loop: python examples/navsim_agent.py LOG_FOLDER [SCENARIO].

With a scene: recast run LOG_FOLDER ... --planner navsim:examples.navsim_agent:Coasting
"""

import sys

import numpy as np

from recast.logs import read_log
from recast.simulation import MOTIONS, NullRenderer, RolloutSetup, camera_mounts, run_rollout
from recast_bridges.navsim import AgentInput, NavsimPlanner, SensorConfig, Trajectory


class Coasting:
    """Looks ahead with one camera, and drives on as fast as it drives."""

    def name(self) -> str:
        return "coasting"

    def initialize(self) -> None:
        """Load weights here."""

    def get_sensor_config(self) -> SensorConfig:
        return SensorConfig(cam_f0=[3])  # of the present frame

    def compute_trajectory(self, agent_input: AgentInput) -> Trajectory:
        image = agent_input.cameras[-1].cam_f0.image
        assert image is not None and image.shape[2] == 3
        poses = np.zeros((8, 3), np.float32)  # every 0.5 s
        poses[:, 0] = agent_input.ego_statuses[-1].ego_velocity[0] * 0.5 * np.arange(1, 9)
        return Trajectory(poses)


def main(folder: str, scenario: str = "cut-in-a") -> None:
    log = read_log(folder)
    setup = RolloutSetup(log, next(iter(log.tracks)), MOTIONS[scenario])
    black = NullRenderer(camera_mounts(log, scale=0.5))  # without a scene there is nothing to see
    rollout = run_rollout(setup, NavsimPlanner(Coasting()), black)
    print(f"{rollout.steps_run} steps, {len(rollout.predictions)} plans by {rollout.planner}")


if __name__ == "__main__":
    main(*sys.argv[1:])
