"""Gymnasium environments over the simulator (extra `env`).

Importing this package registers `recast/Driving-v0`, so that
`gymnasium.make("recast.envs:recast/Driving-v0", log=..., actors=...)` works.
"""

from recast.core.errors import InputError

try:
    import gymnasium
except ImportError:
    raise InputError(
        "recast.envs", "gymnasium", "is not installed", "pip install 'recast-sim[env]'"
    ) from None

from recast.envs.driving_env import BaseReward, DrivingEnv, ProgressReward, StepFacts

ENV_ID = "recast/Driving-v0"
"""The id of `DrivingEnv` for `gymnasium.make`."""

if ENV_ID not in gymnasium.registry:
    gymnasium.register(id=ENV_ID, entry_point="recast.envs.driving_env:DrivingEnv")

__all__ = ["ENV_ID", "BaseReward", "DrivingEnv", "ProgressReward", "StepFacts"]
