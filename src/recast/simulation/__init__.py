"""The simulator, scenarios and actor motions, ego controllers, and what a rollout leaves behind.

The renderer over a reconstructed scene is in `recast.simulation.scene_renderer`: everything here
works without torch.
"""

from recast.simulation.actor_motion import (
    ActorMotion,
    AnyMotion,
    BaseMotion,
    BaseScript,
    MotionInput,
    ScriptMotion,
    StartSituation,
)
from recast.simulation.actors import PreparedActor, PreparedRollout, prepare
from recast.simulation.motions import (
    Advancing,
    CutIn,
    Idm,
    LoggedMotion,
    Oncoming,
    Stationary,
    TimedPath,
)
from recast.simulation.plan_execution import (
    BaseController,
    EgoController,
    LqrController,
    PerfectController,
)
from recast.simulation.planner_calls import PlannerProcess
from recast.simulation.recorded_road import Ending, RoadSurface
from recast.simulation.renderer import (
    BaseRenderer,
    MountedRenderer,
    NullRenderer,
    RendererAround,
    SensorRenderer,
    camera_mount,
    camera_mounts,
)
from recast.simulation.rollout import (
    EGO_COLUMNS,
    PATH_COLUMNS,
    Rollout,
    RolloutFailure,
    ego_centre,
)
from recast.simulation.rollout_files import load_rollout, save_rollout
from recast.simulation.running import (
    error_fields,
    failure,
    probe_path,
    run_rollout,
)
from recast.simulation.scenario import (
    BuiltInMotion,
    Scenario,
    ScenarioActor,
    ScriptedMotion,
    further_actors,
    replaced_tracks,
    scenario_numbers,
    target_motion,
)
from recast.simulation.scenario_file import motion_of_record, read_scenario, scenario_record
from recast.simulation.scenario_names import MOTIONS, motion, parse_motions, scenario_name
from recast.simulation.setup import RolloutSettings, RolloutSetup, make_setup
from recast.simulation.simulator import Observation, OnFrame, Simulator, Timings
from recast.simulation.state import ControlledActor, RolloutOrigin, SimActor, SimState

__all__ = [
    "EGO_COLUMNS",
    "MOTIONS",
    "PATH_COLUMNS",
    "ActorMotion",
    "Advancing",
    "AnyMotion",
    "BaseController",
    "BaseMotion",
    "BaseRenderer",
    "BaseScript",
    "BuiltInMotion",
    "ControlledActor",
    "CutIn",
    "EgoController",
    "Ending",
    "Idm",
    "LoggedMotion",
    "LqrController",
    "MotionInput",
    "MountedRenderer",
    "NullRenderer",
    "Observation",
    "OnFrame",
    "Oncoming",
    "PerfectController",
    "PlannerProcess",
    "PreparedActor",
    "PreparedRollout",
    "RendererAround",
    "RoadSurface",
    "Rollout",
    "RolloutFailure",
    "RolloutOrigin",
    "RolloutSettings",
    "RolloutSetup",
    "Scenario",
    "ScenarioActor",
    "ScriptMotion",
    "ScriptedMotion",
    "SensorRenderer",
    "SimActor",
    "SimState",
    "Simulator",
    "StartSituation",
    "Stationary",
    "TimedPath",
    "Timings",
    "camera_mount",
    "camera_mounts",
    "ego_centre",
    "error_fields",
    "failure",
    "further_actors",
    "load_rollout",
    "make_setup",
    "motion",
    "motion_of_record",
    "parse_motions",
    "prepare",
    "probe_path",
    "read_scenario",
    "replaced_tracks",
    "run_rollout",
    "save_rollout",
    "scenario_name",
    "scenario_numbers",
    "scenario_record",
    "target_motion",
]
