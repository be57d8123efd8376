"""Tables of a rollout's files: columns of states and poses, and the further controlled actors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.records import Record
from recast.simulation.rollout import PATH_COLUMNS
from recast.simulation.state import ControlledActor
from recast.tables import Table, read_parquet

MEND = "write the rollout anew with this recast"


def prefixed(prefix: str, names: Sequence[str]) -> list[str]:
    """Names of columns."""
    return [f"{prefix}_{name}" for name in names]


def number_columns(prefix: str, names: Sequence[str], values: Array) -> dict[str, pa.Array]:
    """Columns of an array (N, len(names))."""
    return {
        name: pa.array(np.ascontiguousarray(values[:, i]))
        for i, name in enumerate(prefixed(prefix, names))
    }


def list_column(values: Array) -> pa.Array:
    """A column of lists: an array (N, ...), row by row."""
    flat = np.ascontiguousarray(values, np.float64).reshape(
        len(values), int(np.prod(values.shape[1:]))
    )
    return pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel()), flat.shape[1])


def read_numbers(table: Table, prefix: str, names: Sequence[str]) -> Array:
    """What `number_columns` wrote: (N, len(names)) float64."""
    values = [table.numbers(name) for name in prefixed(prefix, names)]
    return np.stack(values, axis=1).astype(np.float64)


def read_whole(table: Table, name: str) -> NDArray[np.int64]:
    """A column of whole numbers (N,).

    Raises:
        InputError: it holds others.
    """
    values = table.numbers(name)
    if values.dtype.kind not in "iu" or (values > np.iinfo(np.int64).max).any():
        problem = f"holds {values.dtype}, not whole numbers"
        raise InputError(table.path, f"column {name}", problem, MEND)
    return values.astype(np.int64)


ACTOR_COLUMNS = (*prefixed("actor", PATH_COLUMNS), "world_from_actor")
"""Of a controlled actor's states and poses."""


class ActorHeader(Record):
    """The scalars of a `ControlledActor`."""

    track_id: str
    category: str
    motion: str
    setting: str
    size: tuple[float, float, float]


def actors_table(actors: Sequence[ControlledActor]) -> pa.Table:
    """One row a state, actor by actor."""
    indices = [np.full(len(actor.states), number) for number, actor in enumerate(actors)]
    return pa.table(
        {
            "actor": pa.array(np.concatenate(indices)),
            **number_columns("actor", PATH_COLUMNS, np.concatenate([a.states for a in actors])),
            "world_from_actor": list_column(np.concatenate([a.world_from_actor for a in actors])),
        }
    )


def read_actors(folder: Path, headers: Sequence[ActorHeader]) -> tuple[ControlledActor, ...]:
    """The further controlled actors of a rollout's folder; none without headers."""
    if not headers:
        return ()
    table = read_parquet(folder / "actors.parquet", ("actor", *ACTOR_COLUMNS), MEND)
    index, states = read_whole(table, "actor"), read_numbers(table, "actor", PATH_COLUMNS)
    poses = table.lists("world_from_actor", 16).reshape(-1, 4, 4)
    return tuple(
        ControlledActor(
            track_id=one.track_id,
            category=one.category,
            motion=one.motion,
            setting=one.setting,
            states=states[index == number],
            world_from_actor=poses[index == number],
            size=np.array(one.size),
        )
        for number, one in enumerate(headers)
    )
