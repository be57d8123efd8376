"""Scores of other benchmarks for the stored rollouts of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from recast.core import files
from recast.core.diagnostics import Progress, tell
from recast.core.errors import InputError, printable
from recast.logs import HdMap, map_of, read_log
from recast.metrics.table import Metric, rounded
from recast.runs.display import narrow_table
from recast.runs.rollouts import read_rollout
from recast.runs.run_folder import RunFolder, use_parts
from recast.simulation import Rollout
from recast_bridges.scores import alpasim_scene_score, driven_epdms, neuroncap_score

VERSION = 1
_USE = "rollout"
_OF_ROLLOUT = ("name", "planner", "arm", "motion", "setting")


@dataclass(frozen=True)
class StoredScoreColumn:
    """How a score is shown: as `scale` times its value, with a unit."""

    label: str
    unit: str
    scale: float


SCORES: Mapping[str, StoredScoreColumn] = {
    "epdms_plans": StoredScoreColumn("EPDMS plans", "%", 100.0),
    "alpasim": StoredScoreColumn("AlpaSim", "%", 100.0),
    "neuroncap": StoredScoreColumn("NCAP", "stars", 1.0),
    "neuroncap_code": StoredScoreColumn("NCAP code", "stars", 1.0),
}
"""Scores in the order of the table; higher is better."""


@dataclass(frozen=True)
class ForeignScores:
    """What one rollout scored."""

    # name, planner, arm, motion, setting: the same as in `Rollout`.
    name: str
    planner: str
    arm: str
    motion: str
    setting: str
    values: Mapping[str, Metric]  # metrics by key of `SCORES`
    details: Mapping[str, Any]  # each score with what it was made from, as plain data


def score_run(path: str | Path, progress: Progress | None = None) -> tuple[ForeignScores, ...]:
    """Score all rollouts of a run; those that failed are left out. Raises InputError: the folder is
    no run or has no rollouts yet; or its log, its store or a rollout is missing or damaged."""
    run = RunFolder.open(path)
    uses = [use for use in run.record.artefacts if use_parts(use)[0] == _USE]
    if not uses:
        raise InputError(path, "rollouts", "do not exist yet", "make them with `recast run`")
    hd_map, store = map_of(read_log(run.log_path)), run.store()
    found = []
    for done, use in enumerate(uses):
        tell(progress, done, len(uses))
        rollout = read_rollout(store.open(run.record.artefacts[use]).path)
        if isinstance(rollout, Rollout):
            found.append(score_rollout(rollout, hd_map))
    tell(progress, len(uses), len(uses))
    return tuple(found)


def score_rollout(rollout: Rollout, hd_map: HdMap) -> ForeignScores:
    """Score one rollout; what has no value says why."""
    epdms = driven_epdms(rollout, hd_map)
    alpasim = alpasim_scene_score(rollout, hd_map)
    ncap, code = (neuroncap_score(rollout, when) for when in ("four-seconds", "log-end"))
    metrics = (epdms.mean, alpasim.score, ncap.score, code.score)
    details = (one.to_json() for one in (epdms, alpasim, ncap, code))
    return ForeignScores(
        **{name: getattr(rollout, name) for name in _OF_ROLLOUT},
        values=dict(zip(SCORES, metrics, strict=True)),
        details=dict(zip(SCORES, details, strict=True)),
    )


def write_scores(scores: Sequence[ForeignScores], path: Path) -> None:
    """Write a JSON file: `version`, and `rollouts` with each score and what it was made from."""
    rows = [
        {
            **{key: getattr(one, key) for key in _OF_ROLLOUT},
            "scores": one.details,
        }
        for one in scores
    ]
    files.write_json(path, rounded({"version": VERSION, "rollouts": rows}))


@dataclass(frozen=True)
class ScoreRow:
    """Means over the rollouts of a planner under an arm."""

    planner: str
    arm: str
    rollouts: int  # number of rollouts that were scored
    # means by key of `SCORES`, in the column's unit; None without any rollout.
    means: Mapping[str, float | None]
    counts: Mapping[str, int]  # number of rollouts that a mean is taken over, by key of `SCORES`


def score_rows(scores: Sequence[ForeignScores]) -> list[ScoreRow]:
    """A row for each planner and arm, in the order in which they first occur."""
    rows = []
    for planner, arm in dict.fromkeys((one.planner, one.arm) for one in scores):
        mine = [one for one in scores if (one.planner, one.arm) == (planner, arm)]
        means: dict[str, float | None] = {}
        counts: dict[str, int] = {}
        for key, column in SCORES.items():
            values = [value for one in mine if (value := one.values[key].value) is not None]
            counts[key] = len(values)
            means[key] = column.scale * float(np.mean(values)) if values else None
        rows.append(ScoreRow(planner, arm, len(mine), means, counts))
    return rows


def score_table(rows: Sequence[ScoreRow]) -> Table:
    """The rows for a terminal; means over fewer rollouts than were scored say over how many."""
    figures = [f"{one.label} {one.unit}".replace(" ", "\n", 1) for one in SCORES.values()]
    table = narrow_table(None, ("planner", "arm"), ("rollouts", *figures))
    for row in rows:
        cells = []
        for key, mean in row.means.items():
            partly = f" ({row.counts[key]})" if 0 < row.counts[key] < row.rollouts else ""
            cells.append("n/a" if mean is None else f"{mean:.2f}{partly}")
        table.add_row(printable(row.planner), printable(row.arm), str(row.rollouts), *cells)
    return table
