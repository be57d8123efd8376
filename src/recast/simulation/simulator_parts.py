"""What a simulator is made from: a setup from names and motions, a renderer from a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from recast.errors import InputError
from recast.logs.types import DrivingLog
from recast.simulation.actor_motion import AnyMotion
from recast.simulation.renderer import SensorRenderer, camera_mounts
from recast.simulation.scenario import motion
from recast.simulation.scenario_parts import Scenario
from recast.simulation.setup import RolloutSettings, RolloutSetup

if TYPE_CHECKING:
    from recast.scene.street_scene import StreetScene


def as_setup(
    log: DrivingLog,
    actors: Mapping[str, str | Path | AnyMotion | Scenario],
    cameras: Sequence[str] | None,
    settings: RolloutSettings,
) -> RolloutSetup:
    """The setup of a rollout; see `Simulator` for the arguments.

    Raises:
        InputError: no actor, no such motion, or bad settings.
    """
    if not isinstance(actors, Mapping) or not actors:
        mend = "name the target and its motion, such as actors={'0': 'cut-in'}"
        raise InputError("Simulator", "actors", "is empty", mend)
    unknown = set(settings) - set(RolloutSettings.__annotations__)
    if unknown:
        mend = f"the settings are {', '.join(RolloutSettings.__annotations__)}"
        raise InputError("Simulator", sorted(unknown)[0], "is no setting", mend)
    (target, target_motion), *others = ((key, motion(value)) for key, value in actors.items())
    further: dict[str, AnyMotion] = {}
    for key, value in others:
        if isinstance(value, Scenario):
            problem = f"track {key} is given the scenario {value.name}, which has several actors"
            raise InputError("Simulator", "actors", problem, "give it to the first track")
        further[key] = value
    names = None if cameras is None else tuple(cameras)
    return RolloutSetup(log, target, target_motion, camera_names=names, actors=further, **settings)


def as_renderer(
    log: DrivingLog,
    scene: StreetScene | SensorRenderer | None,
    cameras: Sequence[str] | None,
    scale: float,
    device: str,
) -> SensorRenderer | None:
    """The renderer of a simulator; see `Simulator` for the arguments.

    Raises:
        InputError: no such camera or device, a scale that is no size, or what is no scene.
    """
    if scene is None:
        if cameras:
            raise InputError("Simulator", "cameras", "are given without a scene", "give a scene")
        return None
    if hasattr(scene, "render") and hasattr(scene, "mounts"):
        return cast(SensorRenderer, scene)
    if not hasattr(scene, "background") or not hasattr(scene, "actors"):
        problem = f"is a {type(scene).__name__}"
        mend = "give a StreetScene, a renderer with mounts and render, or None"
        raise InputError("Simulator", "scene", problem, mend)
    if not 0.0 < scale <= 4.0:
        raise InputError("Simulator", "scale", f"is {scale}", "give more than 0, at most 4")
    from recast.simulation.scene_renderer import SceneRenderer  # needs torch

    return SceneRenderer(scene, camera_mounts(log, cameras, scale), device)
