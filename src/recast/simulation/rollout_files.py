"""Rollouts on disk: `rollout.json` (versioned header) and three parquet tables, never pickle.

- `rollout.parquet`: one row a state, columns `ego_*`, `log_ego_*`, `actor_*`, and the two 4x4 poses
  as lists of 16 numbers, row by row.
- `plans.parquet`: one row a plan, `plan_step` and `waypoints`, 120 numbers x0, y0, h0, x1, ...
- `route.parquet`: the reference route, `x` and `y`.
- `actors.parquet`, only with several controlled actors: one row a state of a further one, `actor`
  (its number in `rollout.json`, from 0) and columns as for the target.

Beside them, for a refined actor, `coverage.parquet`: one row an image, see `save_coverage`.

No timings are stored: the same setup gives the same bytes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from recast.core.errors import InputError
from recast.core.files import atomic_file, atomic_folder, write_json
from recast.core.records import Record, read_record
from recast.planning import WAYPOINTS
from recast.simulation.rollout import EGO_COLUMNS, PATH_COLUMNS, Rollout
from recast.simulation.rollout_tables import (
    ACTOR_COLUMNS,
    MEND,
    ActorHeader,
    actors_table,
    list_column,
    number_columns,
    prefixed,
    read_actors,
    read_numbers,
    read_whole,
)
from recast.tables import read_parquet

if TYPE_CHECKING:
    from recast.simulation.coverage import RolloutCoverage

VERSION: Literal[2] = 2
"""1 called the arm a method."""

_STATE_COLUMNS = (
    *prefixed("ego", EGO_COLUMNS),
    *prefixed("log_ego", PATH_COLUMNS),
    *ACTOR_COLUMNS,
    "world_from_rig",
)


class RolloutHeader(Record):
    """The scalars of a `Rollout`, whose `validate` has their ranges; `version` guards against
    readers of another layout. Empty `controlled` and `reactive` are not written."""

    format: Literal["recast-rollout"] = "recast-rollout"
    version: Literal[2] = VERSION
    name: str
    arm: str
    track_id: str
    motion: str
    setting: str
    planner: str
    start_timestamp_us: int
    dt: float
    steps_requested: int
    steps_run: int
    cut_reason: str | None
    actor_size: tuple[float, float, float]
    ego_size: tuple[float, float]
    ego_centre_offset: float
    other_actors: tuple[str, ...]
    controlled: tuple[ActorHeader, ...] = ()
    reactive: tuple[str, ...] = ()


def save_rollout(rollout: Rollout, folder: str | Path) -> None:
    """Write `rollout` to a new folder, whole or not at all.

    Raises:
        ValueError: the rollout's arrays do not fit each other.
        InputError: the folder exists already, or the disk is full.
    """
    rollout.validate()
    header = RolloutHeader(
        name=rollout.name,
        arm=rollout.arm,
        track_id=rollout.track_id,
        motion=rollout.motion,
        setting=rollout.setting,
        planner=rollout.planner,
        start_timestamp_us=rollout.start_timestamp_us,
        dt=rollout.dt,
        steps_requested=rollout.steps_requested,
        steps_run=rollout.steps_run,
        cut_reason=rollout.cut_reason,
        actor_size=tuple(rollout.actor_size.tolist()),
        ego_size=tuple(rollout.ego_size.tolist()),
        ego_centre_offset=rollout.ego_centre_offset,
        other_actors=rollout.other_actors,
        controlled=tuple(
            ActorHeader(
                track_id=actor.track_id,
                category=actor.category,
                motion=actor.motion,
                setting=actor.setting,
                size=tuple(actor.size.tolist()),
            )
            for actor in rollout.controlled
        ),
        reactive=rollout.reactive,
    )
    empty = {name for name in ("controlled", "reactive") if not getattr(header, name)}
    states = {
        **number_columns("ego", EGO_COLUMNS, rollout.ego),
        **number_columns("log_ego", PATH_COLUMNS, rollout.log_ego),
        **number_columns("actor", PATH_COLUMNS, rollout.actor),
        "world_from_rig": list_column(rollout.world_from_rig),
        "world_from_actor": list_column(rollout.world_from_actor),
    }
    plans = {
        "plan_step": pa.array(rollout.plan_steps),
        "waypoints": list_column(rollout.predictions),
    }
    route = {"x": pa.array(rollout.route[:, 0]), "y": pa.array(rollout.route[:, 1])}
    with atomic_folder(folder) as partial:
        write_json(partial / "rollout.json", json.loads(header.model_dump_json(exclude=empty)))
        pq.write_table(pa.table(states), partial / "rollout.parquet")
        pq.write_table(pa.table(plans), partial / "plans.parquet")
        pq.write_table(pa.table(route), partial / "route.parquet")
        if rollout.controlled:
            pq.write_table(actors_table(rollout.controlled), partial / "actors.parquet")


def load_rollout(folder: str | Path) -> Rollout:
    """Read a rollout back, bit for bit.

    Raises:
        InputError: a file or column is missing or broken, the header is of another version, or what
            they hold is no rollout, see `Rollout.validate`.
    """
    folder = Path(folder)
    header = read_record(folder / "rollout.json", RolloutHeader, VERSION, MEND, "recast-rollout")
    states = read_parquet(folder / "rollout.parquet", _STATE_COLUMNS, MEND)
    plans = read_parquet(folder / "plans.parquet", ("plan_step", "waypoints"), MEND)
    route = read_parquet(folder / "route.parquet", ("x", "y"), MEND)
    rollout = Rollout(
        name=header.name,
        arm=header.arm,
        track_id=header.track_id,
        motion=header.motion,
        setting=header.setting,
        planner=header.planner,
        start_timestamp_us=header.start_timestamp_us,
        dt=header.dt,
        steps_requested=header.steps_requested,
        cut_reason=header.cut_reason,
        ego=read_numbers(states, "ego", EGO_COLUMNS),
        log_ego=read_numbers(states, "log_ego", PATH_COLUMNS),
        actor=read_numbers(states, "actor", PATH_COLUMNS),
        world_from_rig=states.lists("world_from_rig", 16).reshape(-1, 4, 4),
        world_from_actor=states.lists("world_from_actor", 16).reshape(-1, 4, 4),
        actor_size=np.array(header.actor_size),
        ego_size=np.array(header.ego_size),
        ego_centre_offset=header.ego_centre_offset,
        predictions=plans.lists("waypoints", 3 * WAYPOINTS).reshape(-1, WAYPOINTS, 3),
        plan_steps=read_whole(plans, "plan_step"),
        route=np.stack([route.numbers("x"), route.numbers("y")], axis=1).astype(np.float64),
        other_actors=header.other_actors,
        controlled=read_actors(folder, header.controlled),
        reactive=header.reactive,
    )
    try:
        rollout.validate()
        if rollout.steps_run != header.steps_run:
            raise ValueError(f"steps_run is {header.steps_run}, the table has {rollout.steps_run}")
    except ValueError as error:
        raise InputError(folder, "rollout", str(error), MEND) from None
    return rollout


def save_coverage(coverage: RolloutCoverage, path: str | Path) -> None:
    """Write a table with a row an image: camera, step, planned (1 if the planner was given it, else
    0), pixels, seen, mirrored, invented.

    Raises:
        ValueError: the coverage is not valid.
        InputError: the disk refuses.
    """
    from recast.simulation.coverage import SHARES  # needs torch

    coverage.validate()
    images = coverage.images
    columns = {
        "camera": pa.array([image.camera for image in images], pa.string()),
        "step": pa.array([image.step for image in images], pa.int64()),
        "planned": pa.array([int(image.planned) for image in images], pa.int8()),
    }
    for name in ("pixels", *SHARES):
        values = [getattr(image.coverage, name) for image in images]
        columns[name] = pa.array(values, pa.float64())
    with atomic_file(path) as partial:
        pq.write_table(pa.table(columns), partial)


def load_coverage(path: str | Path) -> RolloutCoverage:
    """Read back what `save_coverage` wrote.

    Raises:
        InputError: the file or a column is missing or broken, or holds what is no coverage.
    """
    from recast.actors.coverage import Coverage  # needs torch
    from recast.simulation.coverage import SHARES, ImageCoverage, RolloutCoverage

    names = ("pixels", *SHARES)
    table = read_parquet(Path(path), ("camera", "step", "planned", *names), MEND)
    shares = np.stack([table.numbers(name) for name in names], axis=1).astype(np.float64)
    rows = zip(
        table.words("camera").tolist(),
        read_whole(table, "step").tolist(),
        read_whole(table, "planned").tolist(),
        shares.tolist(),
        strict=True,
    )
    coverage = RolloutCoverage(
        tuple(ImageCoverage(name, k, bool(told), Coverage(*row)) for name, k, told, row in rows)
    )
    try:
        coverage.validate()
    except ValueError as error:
        raise InputError(path, "coverage", str(error), MEND) from None
    return coverage
