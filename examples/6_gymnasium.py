"""Four environments at once: python examples/6_gymnasium.py LOG_FOLDER TRACK MOTION [EPISODES]."""

import sys
from functools import partial

import numpy as np
from gymnasium.vector import SyncVectorEnv

from recast.envs import DrivingEnv


def main(source: str, track: str, motion: str, episodes: str = "8") -> None:
    # AsyncVectorEnv takes the same list, and runs each environment in a process of its own.
    make = partial(DrivingEnv, source, actors={track: motion}, action="controls")
    envs = SyncVectorEnv([make] * 4)
    observation, _ = envs.reset(seed=1)
    finished, rewards = 0, np.zeros(4)
    while finished < int(episodes):
        speed = observation["ego"][:, 3]  # (4,) m/s; column 3 is vx
        action = np.stack([0.5 * (8.0 - speed), np.zeros(4)], axis=1)  # m/s^2, rad/s
        observation, reward, terminated, truncated, _ = envs.step(action.astype(np.float32))
        rewards += reward
        for k in np.flatnonzero(terminated | truncated):
            print(f"environment {k}: reward {rewards[k]:.1f}")
            finished, rewards[k] = finished + 1, 0.0
    envs.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
