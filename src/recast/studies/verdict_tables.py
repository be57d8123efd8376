"""Tables on the terminal: agreement with the truth, and what a disagreement is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rich.table import Table

from recast.metrics.pairs import Bootstrap
from recast.runs.display import narrow_table
from recast.studies.results import broken_name, pairs_told, span
from recast.studies.verdict_parts import PartLoss
from recast.studies.verdicts import VerdictCounts


def truth_table(lines: Sequence[VerdictCounts], floor: VerdictCounts | None = None) -> Table:
    """A line for each arm: whether its rollouts end as the truth's do.

    False are collisions that the truth's rollouts do not have, missed are those that they have.

    Args:
        floor: the agreement of the same planner with the disturbed truth.
    """
    beside = [] if floor is None else ["noise\nfloor", "agreement\n/ floor"]
    figures = ["agreement", *beside, "false,\nmissed", "TTC\nerror s", "pairs", "plans"]
    table = narrow_table("against the truth", ["arm"], figures)
    for one in lines:
        ratio = one.over(floor)
        floors = (
            [] if floor is None else [_share(floor), "n/a" if ratio is None else f"{ratio:.2f}"]
        )
        error = one.ttc_error
        table.add_row(
            broken_name(one.arm),
            _share(one),
            *floors,
            f"{one.false_collisions}, {one.missed_collisions}",
            "n/a" if error is None else f"{error.point:.3f}\n{span(error, 3)}",
            pairs_told(one),
            str(one.plans),
        )
    return table


def parts_table(losses: Sequence[PartLoss]) -> Table:
    """A line for each pair of arms that differ in one part: agreement of both, and the loss."""
    figures = ["agree", "of", "lost %", "95 % interval"]
    table = narrow_table("causes of disagreement", ["arm", "part", "without"], figures)
    for one in losses:
        loss = _percent(one.loss)
        table.add_row(
            broken_name(one.arm),
            one.part,
            broken_name(one.other),
            f"{one.agreeing}, {one.other_agreeing}",
            str(one.pairs),
            f"{loss.point:+.1f}",
            f"[{loss.low:+.1f}, {loss.high:+.1f}]",
        )
    return table


def _share(one: VerdictCounts) -> str:
    """How many agree of how many, in percent, and its interval."""
    share = _percent(one.share)
    return f"{one.agreeing}/{one.pairs}\n{share.point:.1f} %\n{span(share, 1)}"


def _percent(one: Bootstrap) -> Bootstrap:
    return replace(one, point=100 * one.point, low=100 * one.low, high=100 * one.high)
