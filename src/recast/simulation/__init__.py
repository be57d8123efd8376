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
from recast.simulation.history import PreparedActor, PreparedRollout, prepare
from recast.simulation.motions import (
    Advancing,
    CutIn,
    Idm,
    LoggedMotion,
    Oncoming,
    Stationary,
    TimedPath,
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
    ControlledActor,
    Rollout,
    RolloutFailure,
    RolloutOrigin,
    SimActor,
    SimState,
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
from recast.simulation.scenario_file import (
    MOTIONS,
    motion,
    motion_of_record,
    parse_motions,
    read_scenario,
    scenario_name,
    scenario_record,
)
from recast.simulation.setup import (
    BaseController,
    EgoController,
    LqrController,
    PerfectController,
    RolloutSettings,
    RolloutSetup,
    make_setup,
)
from recast.simulation.simulator import Observation, OnFrame, Simulator, Timings

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
