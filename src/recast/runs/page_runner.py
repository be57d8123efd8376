"""Rollouts that are run from the viewer's page."""

from __future__ import annotations

from collections.abc import Mapping

from recast.core.diagnostics import Progress
from recast.core.errors import InputError
from recast.logs import DrivingLog, HdMap
from recast.planning import Plan, Planner, PlannerAround, PlannerInput, make_planner
from recast.reconstruction.config import SceneConfig
from recast.runs.config import RunConfig
from recast.runs.rollouts import rollout_setup, run_mounts
from recast.scene import StreetScene
from recast.simulation import (
    MOTIONS,
    RolloutSetup,
    ScriptedMotion,
    run_rollout,
)
from recast.simulation.scene_renderer import SceneRenderer, through_lenses
from recast.viewer import FilmFrames, Runner, ViewedDrive, rollout_drive

_PLANNERS = ("idm-follower", "constant-velocity", "log-replay")
_STEPS = 80
_SCALE = 0.5


def run_runner(
    log: DrivingLog, hdmap: HdMap, config: RunConfig, scenes: Mapping[str, StreetScene | None]
) -> Runner:
    """Runs rollouts as a run does, with its planners, cameras and number of steps."""
    own = {name: config.motion(name) for name in config.motions}
    return _runner(log, hdmap, config, scenes, own)


def log_runner(
    log: DrivingLog,
    hdmap: HdMap,
    scenes: Mapping[str, StreetScene | None],
    first: StreetScene | None,
) -> Runner:
    """Runs rollouts on a log; the target is that of a synthetic log, or the first actor.

    Args:
        first: scene whose actors may be controlled; None: any track of the log.
    """
    modelled = [key for key in log.tracks if first is None or key in first.actors]
    wanted = log.metadata.get("target", "")
    track = wanted if wanted in modelled else next(iter(modelled or log.tracks))
    config = RunConfig(
        track=track,
        motions=(next(iter(MOTIONS)),),
        planners=_PLANNERS,
        steps=_STEPS,
        scene=SceneConfig(scale=_SCALE),
    )
    return _runner(log, hdmap, config, scenes, {})


def _runner(
    log: DrivingLog,
    hdmap: HdMap,
    config: RunConfig,
    scenes: Mapping[str, StreetScene | None],
    own: Mapping[str, ScriptedMotion],
) -> Runner:
    def run(motion: ScriptedMotion, word: str, arm: str, on_step: Progress) -> ViewedDrive:
        setup = rollout_setup(log, hdmap, config, motion, arm)
        return _run(setup, config, scenes.get(arm), word, on_step)

    planners = tuple(dict.fromkeys((*config.planners, *_PLANNERS)))
    return Runner(log, hdmap, config.track, {**own, **MOTIONS}, planners, config.steps, run)


class _Counted(PlannerAround):
    """A planner that tells how far the rollout has come."""

    def __init__(self, planner: Planner, on_step: Progress, steps: int) -> None:
        super().__init__(planner)
        self._on_step, self._steps = on_step, steps

    def plan(self, observation: PlannerInput) -> Plan:
        """See `Planner`."""
        self._on_step(observation.step, self._steps)
        return super().plan(observation)


def _run(
    setup: RolloutSetup, config: RunConfig, scene: StreetScene | None, word: str, on_step: Progress
) -> ViewedDrive:
    """Run one rollout, and film its first camera.

    Raises:
        InputError: the planner looks at images and the arm has no street, or the rollout is
            refused.
    """
    log, cameras = setup.log, setup.camera_names or ()
    planner = make_planner(word, config.planner_device)
    mounts = run_mounts(log, planner, config)
    renderer = None
    if scene is not None and config.track in scene.actors:
        street = scene
        renderer = through_lenses(mounts, lambda pinholes: SceneRenderer(street, pinholes))
    elif planner.needs_images:
        raise InputError(
            f"arm {setup.arm}",
            f"planner {word}",
            "needs images, but this arm has no scene to render",
            "choose another arm or planner",
        )
    total = 2 * config.steps if renderer is not None else config.steps
    rollout = run_rollout(setup, _Counted(planner, on_step, total), renderer)
    shown, film = {}, FilmFrames()
    if renderer is not None and cameras:
        camera = cameras[0]
        shown = {camera: mounts[camera]}
        for step in range(rollout.steps_run):
            film.add(renderer.render(rollout.state(step), (camera,))[camera])
            on_step(config.steps + step + 1, total)
    return rollout_drive(rollout, log, setup.hdmap, shown, dict.fromkeys(shown, film))
