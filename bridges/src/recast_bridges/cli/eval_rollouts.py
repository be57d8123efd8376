"""`recast eval rollouts`: scores of other benchmarks for stored rollouts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from recast.cli import shared
from recast.cli.output import JSON, Rows, console_for, print_json, with_unit

if TYPE_CHECKING:
    from recast_bridges.scores.stored import ForeignScores, ScoreRow


@dataclass(frozen=True)
class EvalRollouts:
    """Score the rollouts of a run by the rules of NAVSIM v2 (EPDMS of every plan), AlpaSim and
    NeuroNCAP."""

    run: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """Folder of `recast run`."""
    out: Annotated[
        Path | None, shared.option("File for the scores of each rollout and plan, as JSON.")
    ] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.core.progress import ProgressBar
        from recast_bridges.scores.stored import (
            score_rows,
            score_run,
            score_table,
            write_scores,
        )

        console = console_for(self.json)
        with ProgressBar("rollouts", console) as progress:
            scores = score_run(self.run, progress)
        if self.out is not None:
            write_scores(scores, self.out)
            console.print(f"wrote {self.out}", markup=False)
        rows = score_rows(scores)
        if self.json:
            print_json(_json_rows(rows, scores))
            return
        console.print(score_table(rows))


def _json_rows(rows: Sequence[ScoreRow], scores: Sequence[ForeignScores]) -> Rows:
    """Means of each planner and arm, and the scores of each rollout with their reasons."""
    from recast_bridges.scores.stored import SCORES

    keys = {key: with_unit(key, column.unit) for key, column in SCORES.items()}
    arms = [
        {
            "planner": row.planner,
            "arm": row.arm,
            "rollouts": row.rollouts,
            **{keys[key]: mean for key, mean in row.means.items()},
            **{f"{key}_rollouts": count for key, count in row.counts.items()},
        }
        for row in rows
    ]
    rollouts = [
        {
            "rollout": one.name,
            "planner": one.planner,
            "arm": one.arm,
            "motion": f"{one.motion}-{one.setting}",
            **{
                keys[key]: None if metric.value is None else SCORES[key].scale * metric.value
                for key, metric in one.values.items()
            },
            **{f"{key}_reason": metric.reason for key, metric in one.values.items()},
        }
        for one in scores
    ]
    return {"arms": arms, "rollouts": rollouts}
