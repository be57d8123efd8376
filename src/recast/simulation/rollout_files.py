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
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import BeforeValidator

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import atomic_folder, write_json
from recast.core.records import Record, read_record
from recast.core.table_files import ArrowTable, read_parquet, write_parquet
from recast.planning import WAYPOINTS
from recast.simulation.rollout import (
    ANY_VEHICLE,
    EGO_COLUMNS,
    PATH_COLUMNS,
    ControlledActor,
    Rollout,
)

if TYPE_CHECKING:
    from recast.simulation.scene_renderer import RolloutCoverage

VERSION: Literal[2] = 2
"""1 called the arm a method."""
_MEND = "write the rollout again with this version of recast"

_Tuple = TypeVar("_Tuple", bound=tuple[float, ...])
_Plain = Annotated[_Tuple, BeforeValidator(lambda v: v.tolist() if hasattr(v, "tolist") else v)]
"""Numbers that may come as an array."""


class ActorHeader(Record):
    """The scalars of a `ControlledActor`."""

    track_id: str
    category: str
    motion: str
    setting: str
    size: _Plain[tuple[float, float, float]]


class RolloutHeader(Record):
    """The scalars of a `Rollout`, whose `validate` has their ranges; `version` guards against
    readers of another layout. Empty `controlled` and `reactive` are not written, nor is the
    category "vehicle"."""

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
    actor_size: _Plain[tuple[float, float, float]]
    ego_size: _Plain[tuple[float, float]]
    ego_centre_offset: float
    category: str = ANY_VEHICLE
    other_actors: tuple[str, ...]
    controlled: tuple[ActorHeader, ...] = ()
    reactive: tuple[str, ...] = ()


def _prefixed(prefix: str, names: Sequence[str]) -> list[str]:
    """Names of columns."""
    return [f"{prefix}_{name}" for name in names]


def _number_columns(prefix: str, names: Sequence[str], values: Array) -> dict[str, pa.Array]:
    """Columns of an array (N, len(names))."""
    return {
        name: pa.array(np.ascontiguousarray(values[:, i]))
        for i, name in enumerate(_prefixed(prefix, names))
    }


def _list_column(values: Array) -> pa.Array:
    """A column of lists: an array (N, ...), row by row."""
    flat = np.ascontiguousarray(values, np.float64).reshape(
        len(values), int(np.prod(values.shape[1:]))
    )
    return pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel()), flat.shape[1])


def _read_numbers(table: ArrowTable, prefix: str, names: Sequence[str]) -> Array:
    """What `number_columns` wrote: (N, len(names)) float64."""
    values = [table.numbers(name) for name in _prefixed(prefix, names)]
    return np.stack(values, axis=1).astype(np.float64)


def _read_whole(table: ArrowTable, name: str) -> NDArray[np.int64]:
    """A column of whole numbers (N,).

    Raises:
        InputError: it holds others.
    """
    values = table.numbers(name)
    if values.dtype.kind not in "iu" or (values > np.iinfo(np.int64).max).any():
        problem = f"holds {values.dtype}, not whole numbers"
        raise InputError(table.path, f"column {name}", problem, _MEND)
    return values.astype(np.int64)


_ACTOR_COLUMNS = (*_prefixed("actor", PATH_COLUMNS), "world_from_actor")
_STATE_COLUMNS = (
    *_prefixed("ego", EGO_COLUMNS),
    *_prefixed("log_ego", PATH_COLUMNS),
    *_ACTOR_COLUMNS,
    "world_from_rig",
)


def save_rollout(rollout: Rollout, folder: str | Path) -> None:
    """Write `rollout` to a new folder, whole or not at all.

    Raises:
        ValueError: the rollout's arrays do not fit each other.
        InputError: the folder exists already, or the disk is full.
    """
    rollout.validate()
    header = RolloutHeader.model_validate(rollout, from_attributes=True)
    empty = {name for name in ("controlled", "reactive") if not getattr(header, name)}
    empty |= {"category"} if header.category == ANY_VEHICLE else set()
    tables = {
        "rollout": {
            **_number_columns("ego", EGO_COLUMNS, rollout.ego),
            **_number_columns("log_ego", PATH_COLUMNS, rollout.log_ego),
            **_number_columns("actor", PATH_COLUMNS, rollout.actor),
            "world_from_rig": _list_column(rollout.world_from_rig),
            "world_from_actor": _list_column(rollout.world_from_actor),
        },
        "plans": {
            "plan_step": pa.array(rollout.plan_steps),
            "waypoints": _list_column(rollout.predictions),
        },
        "route": {"x": pa.array(rollout.route[:, 0]), "y": pa.array(rollout.route[:, 1])},
    }
    if actors := rollout.controlled:
        indices = [np.full(len(actor.states), number) for number, actor in enumerate(actors)]
        states = np.concatenate([actor.states for actor in actors])
        poses = np.concatenate([actor.world_from_actor for actor in actors])
        tables["actors"] = {
            "actor": pa.array(np.concatenate(indices)),
            **_number_columns("actor", PATH_COLUMNS, states),
            "world_from_actor": _list_column(poses),
        }
    with atomic_folder(folder) as partial:
        write_json(partial / "rollout.json", json.loads(header.model_dump_json(exclude=empty)))
        for name, columns in tables.items():
            write_parquet(partial / f"{name}.parquet", pa.table(columns))


def load_rollout(folder: str | Path) -> Rollout:
    """Read a rollout back, bit for bit.

    Raises:
        InputError: a file or column is missing or broken, the header is of another version, or what
            they hold is no rollout, see `Rollout.validate`.
    """
    folder = Path(folder)
    header = read_record(folder / "rollout.json", RolloutHeader, VERSION, _MEND, "recast-rollout")
    states = read_parquet(folder / "rollout.parquet", _STATE_COLUMNS, _MEND)
    plans = read_parquet(folder / "plans.parquet", ("plan_step", "waypoints"), _MEND)
    route = read_parquet(folder / "route.parquet", ("x", "y"), _MEND)
    scalars = header.model_dump(exclude={"format", "version", "steps_run"})
    arrays = {
        "ego": _read_numbers(states, "ego", EGO_COLUMNS),
        "log_ego": _read_numbers(states, "log_ego", PATH_COLUMNS),
        "actor": _read_numbers(states, "actor", PATH_COLUMNS),
        "world_from_rig": states.lists("world_from_rig", 16).reshape(-1, 4, 4),
        "world_from_actor": states.lists("world_from_actor", 16).reshape(-1, 4, 4),
        "actor_size": np.array(header.actor_size),
        "ego_size": np.array(header.ego_size),
        "predictions": plans.lists("waypoints", 3 * WAYPOINTS).reshape(-1, WAYPOINTS, 3),
        "plan_steps": _read_whole(plans, "plan_step"),
        "route": np.stack([route.numbers("x"), route.numbers("y")], axis=1).astype(np.float64),
        "controlled": _read_actors(folder, header.controlled),
    }
    rollout = Rollout(**(scalars | arrays))
    try:
        rollout.validate()
        if rollout.steps_run != header.steps_run:
            raise ValueError(
                f"steps_run is {header.steps_run}, but the table has {rollout.steps_run} steps"
            )
    except ValueError as error:
        raise InputError(folder, "rollout", str(error), _MEND) from None
    return rollout


def _read_actors(folder: Path, headers: Sequence[ActorHeader]) -> tuple[ControlledActor, ...]:
    """The further controlled actors of a rollout's folder; none without headers."""
    if not headers:
        return ()
    table = read_parquet(folder / "actors.parquet", ("actor", *_ACTOR_COLUMNS), _MEND)
    index, states = _read_whole(table, "actor"), _read_numbers(table, "actor", PATH_COLUMNS)
    poses = table.lists("world_from_actor", 16).reshape(-1, 4, 4)
    actors = []
    for number, header in enumerate(headers):
        own = index == number
        scalars = header.model_dump() | {"size": np.array(header.size)}
        actors.append(ControlledActor(**scalars, states=states[own], world_from_actor=poses[own]))
    return tuple(actors)


def save_coverage(coverage: RolloutCoverage, path: str | Path) -> None:
    """Write a table with a row an image: camera, step, planned (1 if the planner was given it, else
    0), pixels, seen, mirrored, invented.

    Raises:
        ValueError: the coverage is not valid.
        InputError: the disk refuses.
    """
    from recast.simulation.scene_renderer import SHARES  # needs torch

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
    write_parquet(Path(path), pa.table(columns))


def load_coverage(path: str | Path) -> RolloutCoverage:
    """Read back what `save_coverage` wrote.

    Raises:
        InputError: the file or a column is missing or broken, or holds what is no coverage.
    """
    from recast.actors.actor import Coverage  # needs torch
    from recast.simulation.scene_renderer import SHARES, ImageCoverage, RolloutCoverage

    names = ("pixels", *SHARES)
    table = read_parquet(Path(path), ("camera", "step", "planned", *names), _MEND)
    shares = np.stack([table.numbers(name) for name in names], axis=1).astype(np.float64)
    rows = zip(
        table.words("camera").tolist(),
        _read_whole(table, "step").tolist(),
        _read_whole(table, "planned").tolist(),
        shares.tolist(),
        strict=True,
    )
    coverage = RolloutCoverage(
        tuple(
            ImageCoverage(name, k, bool(planned), Coverage(*row)) for name, k, planned, row in rows
        )
    )
    try:
        coverage.validate()
    except ValueError as error:
        raise InputError(path, "coverage", str(error), _MEND) from None
    return coverage
