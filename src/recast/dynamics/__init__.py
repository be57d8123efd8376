"""Vehicle models and controllers: numpy float64, any leading batch dimensions."""

from recast.dynamics import state
from recast.dynamics.idm import (
    IdmParameters,
    free_road_acceleration,
    free_road_step,
    idm_acceleration,
    idm_step,
)
from recast.dynamics.state import (
    PACIFICA,
    EgoState,
    VehicleParameters,
    ground_velocities,
    initial_state,
    make_state,
)
from recast.dynamics.tracker import (
    PRESETS,
    BicycleModel,
    LqrWeights,
    Profile,
    ProfileWeights,
    TrackerConfig,
    fit_profile,
    follow_perfectly,
    lqr_command,
    plan_to_poses,
    track,
)

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
    "ground_velocities",
    "idm_acceleration",
    "idm_step",
    "initial_state",
    "lqr_command",
    "make_state",
    "plan_to_poses",
    "state",
    "track",
]
