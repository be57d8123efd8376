"""`recast planner probe`: rollouts with the target in the pictures, and erased from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from recast.arrays import Image
from recast.cameras import CameraMount
from recast.core.artefact import value_hash
from recast.core.errors import InputError
from recast.logs import DrivingLog, Track
from recast.metrics.driving import no_collision
from recast.planning import BasePlanner, make_planner
from recast.runs.sources import RECIPES, planner_source
from recast.simulation import (
    Rollout,
    RolloutSetup,
    ScriptedMotion,
    SimState,
    ego_centre,
    load_rollout,
    parse_motions,
    run_rollout,
    save_rollout,
    scenario_name,
    scenario_record,
)
from recast.simulation.oracle_renderer import OracleRenderer
from recast.simulation.renderer import RendererAround
from recast.synthetic import make_rig, make_world
from recast.synthetic.world import World

VISIBLE, ERASED = "visible", "erased"
_SIZE = (480, 320)
"""Width and height of images in runs, pixels."""
_FAR_BELOW = 1000.0
"""Metres under the road, where an erased vehicle is drawn."""


@dataclass(frozen=True)
class ProbeRequest:
    """What is probed; see `recast planner probe` for the members."""

    planner: str
    out: Path
    scenes: Sequence[str]
    motions: Sequence[str]
    seed: int
    seconds: float
    full_size: bool
    workers: int
    device: str = "auto"


@dataclass(frozen=True)
class ProbeRow:
    """One scenario in one scene, driven twice.

    Attributes:
        collided: time of the first contact by arm, seconds; None without any.
        nearest: least distance between the boxes' centres, by arm, metres.
        driven: distance driven, by arm, metres.
        problem: reason why there is no rollout; the rest is empty then.
    """

    scene: str
    scenario: str
    collided: Mapping[str, float | None]
    nearest: Mapping[str, float]
    driven: Mapping[str, float]
    problem: str | None = None

    @property
    def line(self) -> str:
        """For the terminal."""
        if self.problem is not None:
            return f"{self.scene} {self.scenario}: {self.problem}"
        parts = [
            f"{how} {'clear' if when is None else f'hit at {when:.1f} s'}"
            f" ({self.driven[how]:.0f} m)"
            for how, when in self.collided.items()
        ]
        return f"{self.scene} {self.scenario}: {', '.join(parts)}"


class ErasingRenderer(RendererAround):
    """Another renderer's pictures without the controlled actor; the simulation keeps it."""

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """As the other renderer, with the actor far below the road."""
        gone = state.world_from_actor.copy()
        gone[2, 3] -= _FAR_BELOW
        return self.part.render(replace(state, world_from_actor=gone), camera_names)


def probe(request: ProbeRequest, on_row: Callable[[ProbeRow], None]) -> list[ProbeRow]:
    """Drive every scenario in every scene twice.

    A rollout that lies there is not repeated if the same planner made it by the same settings.

    Raises:
        InputError: no such planner, scene or motion, or the planner reads no images.
    """
    source = planner_source(request.planner)
    planner = make_planner(request.planner, request.device)
    if not planner.needs_images:
        raise InputError(
            "planner", planner.name, "does not use images", "give a planner that uses images"
        )
    width, height = _SIZE
    wanted = {(view.camera.width, view.camera.height) for view in planner.wanted_views}
    if not request.full_size and wanted == {_SIZE}:
        width, height = width // 2, height // 2
    motions = [motion for name in request.motions for motion in parse_motions(name)]
    rows = []
    for scene in request.scenes:
        world = make_world(scene, request.seed, request.seconds)
        mounts = {
            name: CameraMount(mounted.camera, mounted.rig_from_camera)
            for name, mounted in make_rig(width, height).cameras.items()
        }
        with OracleRenderer(world, mounts, request.workers) as renderer:
            for motion in motions:
                rows.append(_drive_twice(request, source, planner, world, renderer, motion))
                on_row(rows[-1])
    return rows


def probe_table(rows: Sequence[ProbeRow]) -> Table:
    """Collisions by scenario, with the target visible and erased, and over all."""
    table = Table(box=SIMPLE_HEAD)
    for column in (
        "scenario",
        "rollouts",
        "hit, visible",
        "hit, erased",
        "driven m, visible",
        "driven m, erased",
    ):
        table.add_column(column, justify="left" if column == "scenario" else "right")
    good = [row for row in rows if row.problem is None]
    names = list(dict.fromkeys(row.scenario for row in good))
    for name in [*names, "all"]:
        some = [row for row in good if name in (row.scenario, "all")]
        hits = [sum(r.collided[how] is not None for r in some) for how in (VISIBLE, ERASED)]
        metres = [
            float(np.mean([r.driven[how] for r in some])) if some else float("nan")
            for how in (VISIBLE, ERASED)
        ]
        table.add_row(name, str(len(some)), *map(str, hits), *(f"{m:.0f}" for m in metres))
    if len(good) < len(rows):
        table.caption = f"{len(rows) - len(good)} rollouts could not be run"
    return table


def _drive_twice(
    request: ProbeRequest,
    source: str,
    planner: BasePlanner,
    world: World,
    renderer: OracleRenderer,
    motion: ScriptedMotion,
) -> ProbeRow:
    vehicle = world.vehicles[world.target]
    track = Track(world.target, vehicle.model.category, vehicle.model.size, vehicle.trajectory)
    name = f"{world.name}-{world.seed}"
    log = DrivingLog(name, {}, {}, world.ego, {world.target: track}, map=world.street.map)
    collided: dict[str, float | None] = {}
    nearest: dict[str, float] = {}
    driven: dict[str, float] = {}
    scenario = f"{motion.name}-{motion.setting}"
    for how, eyes in ((VISIBLE, renderer), (ERASED, ErasingRenderer(renderer))):
        setup = RolloutSetup(
            log, world.target, motion, arm=how, camera_names=tuple(renderer.mounts)
        )
        folder = rollout_folder(request, source, world, motion, how)
        try:
            if folder.exists():
                rollout = load_rollout(folder)
            else:
                rollout = run_rollout(setup, planner, eyes)
                save_rollout(rollout, folder)
        except InputError as error:
            return ProbeRow(world.name, scenario, {}, {}, {}, str(error))
        boxes = ego_centre(rollout.ego[:, :3], rollout.ego_centre_offset)
        found = no_collision(boxes, rollout.ego_size, rollout.actor, rollout.actor_size, rollout.dt)
        collided[how] = None if found.first_step is None else found.first_step * rollout.dt
        apart = np.linalg.norm(boxes[:, :2] - rollout.actor[:, :2], axis=1)
        nearest[how], driven[how] = float(apart.min()), _metres(rollout)
    return ProbeRow(world.name, scenario, collided, nearest, driven)


def rollout_folder(
    request: ProbeRequest, source: str, world: World, motion: ScriptedMotion, how: str
) -> Path:
    """Where a rollout lies: another folder for other code, other settings and another scenario."""
    made_by = {
        "planner": source,
        "device": request.device,
        "seconds": request.seconds,
        "full_size": request.full_size,
        "scenario": scenario_record(motion),
        "recipe": RECIPES["rollout"],
    }
    plain = f"{world.name}-{world.seed}-{scenario_name(motion)}-{how}"
    return request.out / f"{plain}-{value_hash(made_by)[:12]}"


def _metres(rollout: Rollout) -> float:
    return float(np.linalg.norm(np.diff(rollout.ego[:, :2], axis=0), axis=1).sum())
