"""`recast eval rollouts`: scores of other benchmarks for stored rollouts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from recast.cli import shared
from recast.cli.output import JSON, console_for, print_json


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
        from recast.studies.foreign_scores import (
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
            from recast.cli.rows.grids import foreign_rows

            print_json(foreign_rows(rows, scores))
            return
        console.print(score_table(rows))
