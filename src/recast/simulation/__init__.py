"""Scenarios, actor motions, the ego controller, the rollout loop and what it leaves behind.

The renderer over a reconstructed scene is in `recast.simulation.scene_renderer`: everything here
works without torch.
"""

from recast.simulation.batch import RolloutJob, error_fields, failure, run_batch
from recast.simulation.ego_controller import EgoController, LqrController, PerfectController
from recast.simulation.lift import RoadSurface
from recast.simulation.motions import (
    ActorMotion,
    Advancing,
    CutIn,
    Oncoming,
    ScriptedMotion,
    StartSituation,
    Stationary,
)
from recast.simulation.prepare import PreparedRollout, prepare
from recast.simulation.probe_path import probe_path
from recast.simulation.renderer import NullRenderer, SensorRenderer, camera_mount, camera_mounts
from recast.simulation.rollout import (
    EGO_COLUMNS,
    PATH_COLUMNS,
    Rollout,
    RolloutFailure,
    ego_centre,
)
from recast.simulation.rollout_files import load_rollout, save_rollout
from recast.simulation.rollout_loop import OnFrame, Timings, run_rollout
from recast.simulation.scenario import MOTIONS, parse_motions, scenario_name
from recast.simulation.scenario_file import motion_of_record, read_scenario, scenario_record
from recast.simulation.setup import RolloutSetup
from recast.simulation.state import SimState

__all__ = [
    "EGO_COLUMNS",
    "MOTIONS",
    "PATH_COLUMNS",
    "ActorMotion",
    "Advancing",
    "CutIn",
    "EgoController",
    "LqrController",
    "NullRenderer",
    "OnFrame",
    "Oncoming",
    "PerfectController",
    "PreparedRollout",
    "RoadSurface",
    "Rollout",
    "RolloutFailure",
    "RolloutJob",
    "RolloutSetup",
    "ScriptedMotion",
    "SensorRenderer",
    "SimState",
    "StartSituation",
    "Stationary",
    "Timings",
    "camera_mount",
    "camera_mounts",
    "ego_centre",
    "error_fields",
    "failure",
    "load_rollout",
    "motion_of_record",
    "parse_motions",
    "prepare",
    "probe_path",
    "read_scenario",
    "run_batch",
    "run_rollout",
    "save_rollout",
    "scenario_name",
    "scenario_record",
]
