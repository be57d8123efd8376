"""Rollouts that the viewer's page asks for."""

from __future__ import annotations

from collections.abc import Mapping

from recast.errors import InputError
from recast.logs import DrivingLog, HdMap
from recast.pipeline.config import RunConfig
from recast.pipeline.planner import planner_mounts
from recast.planning import Plan, Planner, PlannerInput, PlanningContext, make_planner
from recast.scene import SceneConfig, StreetScene
from recast.simulation import (
    MOTIONS,
    RolloutSetup,
    ScriptedMotion,
    camera_mounts,
    run_rollout,
)
from recast.simulation.lens_renderer import through_lenses
from recast.simulation.scene_renderer import SceneRenderer
from recast.viewer import Drive, FilmFrames, Runner, rollout_drive
from recast.viewer.inputs import OnStep

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
    log: DrivingLog, hdmap: HdMap, scenes: Mapping[str, StreetScene | None],
    first: StreetScene | None,
) -> Runner:  # fmt: skip
    """Runs rollouts on a log; the target is that of a synthetic log, or the first actor.

    Args:
        first: scene whose actors may be controlled; None: any track of the log.
    """
    modelled = [key for key in log.tracks if first is None or key in first.actors]
    wanted = log.metadata.get("target", "")
    track = wanted if wanted in modelled else next(iter(modelled or log.tracks))
    config = RunConfig(
        track=track, motions=(next(iter(MOTIONS)),), planners=_PLANNERS, steps=_STEPS,
        scene=SceneConfig(scale=_SCALE),
    )  # fmt: skip
    return _runner(log, hdmap, config, scenes, {})


def _runner(
    log: DrivingLog, hdmap: HdMap, config: RunConfig,
    scenes: Mapping[str, StreetScene | None], own: Mapping[str, ScriptedMotion],
) -> Runner:  # fmt: skip
    def run(motion: ScriptedMotion, word: str, arm: str, on_step: OnStep) -> Drive:
        return _run(_Asked(log, hdmap, config, scenes.get(arm), arm), motion, word, on_step)

    planners = tuple(dict.fromkeys((*config.planners, *_PLANNERS)))
    return Runner(log, hdmap, config.track, {**own, **MOTIONS}, planners, config.steps, run)


class _Asked:
    """Where a rollout is run: log, map, configuration, and the street of an arm."""

    def __init__(
        self, log: DrivingLog, hdmap: HdMap, config: RunConfig, scene: StreetScene | None, arm: str
    ) -> None:
        self.log, self.hdmap, self.config, self.scene, self.arm = log, hdmap, config, scene, arm

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras of the run."""
        return self.config.scene.cameras or tuple(self.log.cameras)

    def setup(self, motion: ScriptedMotion) -> RolloutSetup:
        """What is run."""
        config = self.config
        return RolloutSetup(
            self.log, config.track, motion, arm=self.arm, map=self.hdmap, steps=config.steps,
            plan_every=config.plan_every, keep_other_actors=config.keep_other_actors,
            camera_names=self.cameras,
        )  # fmt: skip


class _Counted:
    """A planner that tells how far the rollout has come."""

    def __init__(self, planner: Planner, on_step: OnStep, steps: int) -> None:
        self._planner, self._on_step, self._steps = planner, on_step, steps
        self.name, self.needs_images = planner.name, planner.needs_images

    def __getattr__(self, name: str) -> object:
        return getattr(self._planner, name)

    def reset(self, context: PlanningContext) -> None:
        """See `Planner`."""
        self._planner.reset(context)

    def plan(self, observation: PlannerInput) -> Plan:
        """See `Planner`."""
        self._on_step(observation.step, self._steps)
        return self._planner.plan(observation)


def _run(asked: _Asked, motion: ScriptedMotion, word: str, on_step: OnStep) -> Drive:
    """Run one rollout, and film its first camera.

    Raises:
        InputError: the planner looks at images and the arm has no street, or the rollout is
            refused.
    """
    config, scene = asked.config, asked.scene
    planner = make_planner(word, config.planner_device)
    mounts = camera_mounts(asked.log, asked.cameras, config.scene.scale)
    mounts = planner_mounts(mounts, planner, config)
    renderer = None
    if scene is not None and config.track in scene.actors:
        street = scene
        renderer = through_lenses(mounts, lambda pinholes: SceneRenderer(street, pinholes))
    elif planner.needs_images:
        raise InputError(
            f"arm {asked.arm}", f"planner {word}", "looks at images, and there is no street here",
            "choose another arm or planner",
        )  # fmt: skip
    total = 2 * config.steps if renderer is not None else config.steps
    setup = asked.setup(motion)
    rollout = run_rollout(setup, _Counted(planner, on_step, total), renderer)
    shown, film = {}, FilmFrames()
    if renderer is not None and asked.cameras:
        camera = asked.cameras[0]
        shown = {camera: mounts[camera]}
        for step in range(rollout.steps_run):
            film.add(renderer.render(rollout.state(step), (camera,))[camera])
            on_step(config.steps + step + 1, total)
    return rollout_drive(rollout, asked.log, asked.hdmap, shown, dict.fromkeys(shown, film))
