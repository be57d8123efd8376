"""Rollouts on disk: `rollout.json` (versioned header) and three parquet tables, never pickle.

- `rollout.parquet`: one row a state, columns `ego_*`, `log_ego_*`, `actor_*`, and the two 4x4 poses
  as lists of 16 numbers, row by row.
- `plans.parquet`: one row a plan, `plan_step` and `waypoints`, 120 numbers x0, y0, h0, x1, ...
- `route.parquet`: the reference route, `x` and `y`.

No timings are stored: the same setup gives the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from recast.errors import InputError
from recast.records import read_record
from recast.simulation.rollout import EGO_COLUMNS, PATH_COLUMNS, WAYPOINTS, Rollout
from recast.storage import atomic_folder, write_json

Array = NDArray[np.float64]

VERSION: Literal[1] = 1


class RolloutHeader(BaseModel):
    """The scalars of a `Rollout`; `version` guards against readers of another layout."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal["recast-rollout"] = "recast-rollout"
    version: Literal[1] = VERSION
    name: str
    method: str
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


def save_rollout(rollout: Rollout, folder: str | Path) -> None:
    """Write `rollout` to a new folder, whole or not at all.

    Raises:
        ValueError: the rollout's arrays do not fit each other.
        InputError: the folder exists already, or the disk is full.
    """
    rollout.validate()
    header = RolloutHeader(
        name=rollout.name,
        method=rollout.method,
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
    )
    states = {
        **_columns("ego", EGO_COLUMNS, rollout.ego),
        **_columns("log_ego", PATH_COLUMNS, rollout.log_ego),
        **_columns("actor", PATH_COLUMNS, rollout.actor),
        "world_from_rig": _lists(rollout.world_from_rig),
        "world_from_actor": _lists(rollout.world_from_actor),
    }
    plans = {"plan_step": pa.array(rollout.plan_steps), "waypoints": _lists(rollout.predictions)}
    route = {"x": pa.array(rollout.route[:, 0]), "y": pa.array(rollout.route[:, 1])}
    with atomic_folder(folder) as partial:
        write_json(partial / "rollout.json", json.loads(header.model_dump_json()))
        pq.write_table(pa.table(states), partial / "rollout.parquet")
        pq.write_table(pa.table(plans), partial / "plans.parquet")
        pq.write_table(pa.table(route), partial / "route.parquet")


def load_rollout(folder: str | Path) -> Rollout:
    """Read a rollout back, bit for bit.

    Raises:
        InputError: a file or column is missing or broken, or the header is of another version.
    """
    folder = Path(folder)
    header_path = folder / "rollout.json"
    mend = "write the rollout anew with this recast"
    header = read_record(header_path, RolloutHeader, VERSION, mend, "recast-rollout")
    states = _Table(folder / "rollout.parquet")
    plans = _Table(folder / "plans.parquet")
    route = _Table(folder / "route.parquet")
    rollout = Rollout(
        name=header.name,
        method=header.method,
        track_id=header.track_id,
        motion=header.motion,
        setting=header.setting,
        planner=header.planner,
        start_timestamp_us=header.start_timestamp_us,
        dt=header.dt,
        steps_requested=header.steps_requested,
        cut_reason=header.cut_reason,
        ego=states.columns([f"ego_{c}" for c in EGO_COLUMNS]),
        log_ego=states.columns([f"log_ego_{c}" for c in PATH_COLUMNS]),
        actor=states.columns([f"actor_{c}" for c in PATH_COLUMNS]),
        world_from_rig=states.lists("world_from_rig", (4, 4)),
        world_from_actor=states.lists("world_from_actor", (4, 4)),
        actor_size=np.array(header.actor_size),
        ego_size=np.array(header.ego_size),
        ego_centre_offset=header.ego_centre_offset,
        predictions=plans.lists("waypoints", (WAYPOINTS, 3)),
        plan_steps=plans.columns(["plan_step"])[:, 0].astype(np.int64),
        route=route.columns(["x", "y"]),
        other_actors=header.other_actors,
    )
    try:
        rollout.validate()
        if rollout.steps_run != header.steps_run:
            raise ValueError(f"steps_run is {header.steps_run}, the table has {rollout.steps_run}")
    except ValueError as error:
        raise InputError(folder, "tables", str(error), "write the rollout anew") from None
    return rollout


def _columns(prefix: str, names: Sequence[str], values: Array) -> dict[str, pa.Array]:
    return {
        f"{prefix}_{name}": pa.array(np.ascontiguousarray(values[:, i]))
        for i, name in enumerate(names)
    }


def _lists(values: Array) -> pa.Array:
    flat = np.ascontiguousarray(values, np.float64).reshape(
        len(values), int(np.prod(values.shape[1:]))
    )
    return pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel()), flat.shape[1])


class _Table:
    """A parquet table whose missing parts are input errors."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.table = pq.read_table(path)
        except FileNotFoundError:
            raise InputError(path, "file", "is missing", "write the rollout anew") from None
        except (pa.ArrowException, OSError) as error:
            problem = f"cannot be read ({str(error).splitlines()[0]})"
            raise InputError(path, "parquet", problem, "write the rollout anew") from None

    def columns(self, names: Sequence[str]) -> Array:
        """(rows, len(names)) of plain number columns."""
        return np.stack([self._values(name) for name in names], axis=1)

    def lists(self, name: str, shape: tuple[int, ...]) -> Array:
        """(rows, *shape) of a column of lists."""
        column = self._column(name).combine_chunks()
        values = column.flatten().to_numpy(zero_copy_only=False)
        expected = len(column) * int(np.prod(shape))
        if len(values) != expected:
            raise InputError(
                self.path, name, f"{len(values)} numbers, expected {expected}", "write it anew"
            )
        return np.array(values, np.float64).reshape(len(column), *shape)

    def _values(self, name: str) -> Array:
        return np.array(self._column(name).to_numpy(), np.float64)

    def _column(self, name: str) -> pa.ChunkedArray:
        if name not in self.table.column_names:
            raise InputError(self.path, name, "column is missing", "write the rollout anew")
        return self.table.column(name)
