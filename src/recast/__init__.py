"""recast: closed-loop driving simulation from recorded logs with view-complete actors.

The way of the data, as functions and types; each is imported when it is first used:

    log = recast.load_log("runs/kitti/log")
    scene = recast.reconstruct(log)
    actor = recast.make_actor(log, track="0", scene=scene)
    sim = recast.Simulator(log, scene.with_actor(actor), actors={"0": recast.motion("cut-in")})

    my_planner.reset(sim.context)
    observation = sim.reset()
    while not sim.done:
        observation = sim.step(my_planner.plan(observation))
    print(recast.score(sim.rollout))
    recast.write_report(sim.rollout, "runs/kitti/report")
"""

from __future__ import annotations

from recast.lazy import getattr_of, names_of

TYPE_CHECKING = False  # typing's own costs 5 ms; type checkers know the name
if TYPE_CHECKING:
    from recast.actors import Actor as Actor
    from recast.actors import load_actor as load_actor
    from recast.core import Store as Store
    from recast.core.errors import InputError as InputError
    from recast.face import evaluate as evaluate
    from recast.face import load_scene as load_scene
    from recast.face import make_actor as make_actor
    from recast.face import reconstruct as reconstruct
    from recast.face import run_grid as run_grid
    from recast.face import score as score
    from recast.face import search as search
    from recast.face import show as show
    from recast.face import write_report as write_report
    from recast.logs import DrivingLog as DrivingLog
    from recast.logs import load_log as load_log
    from recast.logs import write_log as write_log
    from recast.metrics import RolloutMetrics as RolloutMetrics
    from recast.planning import Plan as Plan
    from recast.planning import Planner as Planner
    from recast.planning import PlannerInput as PlannerInput
    from recast.planning import make_planner as make_planner
    from recast.runs.arms import Arm as Arm
    from recast.scene import StreetScene as StreetScene
    from recast.simulation import Rollout as Rollout
    from recast.simulation import RolloutSettings as RolloutSettings
    from recast.simulation import Simulator as Simulator
    from recast.simulation import motion as motion

    __version__: str

_PLACES = {
    "recast.actors": ("Actor", "load_actor"),
    "recast.core": ("Store",),
    "recast.core.errors": ("InputError",),
    "recast.metrics": ("RolloutMetrics",),
    "recast.logs": ("DrivingLog", "load_log", "write_log"),
    "recast.runs.arms": ("Arm",),
    "recast.face": (
        "evaluate",
        "load_scene",
        "make_actor",
        "reconstruct",
        "run_grid",
        "score",
        "search",
        "show",
        "write_report",
    ),
    "recast.planning": ("Plan", "Planner", "PlannerInput", "make_planner"),
    "recast.scene": ("StreetScene",),
    "recast.simulation": ("Rollout", "RolloutSettings", "Simulator", "motion"),
}
_of_modules = getattr_of(__name__, _PLACES)


def __getattr__(name: str) -> object:
    if name != "__version__":
        return _of_modules(name)
    from importlib.metadata import PackageNotFoundError, version

    try:
        found = version("recast-sim")
    except PackageNotFoundError:  # run from a source tree that was never installed
        found = "0+unknown"
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *names_of(_PLACES), "__version__"})
