"""Vehicle models and controllers: numpy float64, any leading batch dimensions."""

from recast.dynamics import state
from recast.dynamics.bicycle import BicycleModel
from recast.dynamics.ego_state import EgoState
from recast.dynamics.idm import (
    IdmParameters,
    free_road_acceleration,
    free_road_step,
    idm_acceleration,
    idm_step,
)
from recast.dynamics.lqr import LqrWeights, lqr_command
from recast.dynamics.profiles import Profile, ProfileWeights, fit_profile
from recast.dynamics.state import initial_state, make_state
from recast.dynamics.tracker import (
    PRESETS,
    TrackerConfig,
    follow_perfectly,
    plan_to_poses,
    track,
)
from recast.dynamics.vehicle import PACIFICA, VehicleParameters

__all__ = [
    "PACIFICA",
    "PRESETS",
    "BicycleModel",
    "EgoState",
    "IdmParameters",
    "LqrWeights",
    "Profile",
    "ProfileWeights",
    "TrackerConfig",
    "VehicleParameters",
    "fit_profile",
    "follow_perfectly",
    "free_road_acceleration",
    "free_road_step",
    "idm_acceleration",
    "idm_step",
    "initial_state",
    "lqr_command",
    "make_state",
    "plan_to_poses",
    "state",
    "track",
]
