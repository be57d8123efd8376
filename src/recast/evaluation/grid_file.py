"""rollouts.parquet: one row a rollout of a grid. The columns are described in docs/bench.md."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from recast import storage
from recast.evaluation.grid_row import GridRow
from recast.evaluation.table import COLUMNS
from recast.evaluation.verdicts import Verdict, verdicts

SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in ("scene", "world")),
        ("seed", pa.int64()),
        *(
            (name, pa.string())
            for name in ("log", "track_id", "arm", "motion", "setting", "planner")
        ),
        *(
            (name, pa.int64())
            for name in ("start_timestamp_us", "steps_requested", "steps_run", "plans")
        ),
        ("cut_reason", pa.string()),
        *((name, pa.float64()) for name in COLUMNS),
        ("verdict", pa.string()),
        ("first_collision_step", pa.int64()),
        ("map_derived", pa.bool_()),
        ("oracle_verdict", pa.string()),
        ("verdict_agrees", pa.bool_()),
        ("ttc_error", pa.float64()),
        ("plans_compared", pa.int64()),
        ("failure", pa.string()),
        ("failure_reason", pa.string()),
    ]
)
"""Columns and their types; any but scene, arm, motion, setting and planner may be null."""

_OF_ROW = (
    "scene", "world", "seed", "log", "track_id", "arm", "motion", "setting", "planner",
    "start_timestamp_us", "steps_requested", "steps_run", "cut_reason",
    "first_collision_step", "map_derived", "failure", "failure_reason",
)  # fmt: skip


def write_rows(rows: Sequence[GridRow], path: Path, truth: str | None) -> None:
    """Write rows, whole or not at all; the same rows give the same bytes.

    Args:
        truth: the arm that renders the truth; None if none does.
    """
    records = [_record(*pair) for pair in zip(rows, verdicts(rows, truth), strict=True)]
    with storage.atomic_file(path) as partial:
        pq.write_table(pa.Table.from_pylist(records, schema=SCHEMA), partial)


def _record(row: GridRow, verdict: Verdict | None) -> dict[str, object]:
    return {
        **{name: getattr(row, name) for name in _OF_ROW},
        "plans": row.plans if row.failure is None else None,
        **{name: row.scores.get(name) for name in COLUMNS},
        "verdict": _word(row.collided),
        "oracle_verdict": None if verdict is None else _word(verdict.oracle_collided),
        "verdict_agrees": None if verdict is None else verdict.agrees,
        "ttc_error": None if verdict is None else verdict.ttc_error,
        "plans_compared": None if verdict is None else verdict.plans,
    }


def _word(collided: bool | None) -> str | None:
    return None if collided is None else "collision" if collided else "no collision"
