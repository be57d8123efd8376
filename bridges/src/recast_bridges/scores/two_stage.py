"""NAVSIM v2's two stages: EC of pairs, weights of the second stage, both groups, and the table."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.core.files import atomic_file
from recast.planning.pdm import extended_comfort
from recast_bridges.scores.submission import TokenScore

_FIELDS = {
    "no_at_fault_collisions": "no_collision",
    "drivable_area_compliance": "drivable",
    "driving_direction_compliance": "direction",
    "traffic_light_compliance": "traffic_light",
    "ego_progress": "progress",
    "time_to_collision_within_bound": "ttc",
    "lane_keeping": "lane_keeping",
    "history_comfort": "history_comfort",
}
_COMFORT, _SCORE = "two_frame_extended_comfort", "score"
COLUMNS = (*_FIELDS, _COMFORT, _SCORE)
"""NAVSIM's names of the sub-metrics, and of EPDMS."""
SUMMARY = ("stage_one", "stage_two", "combined")
"""Rows of the summary are called `extended_pdm_score_` and one of these."""
_VARIANCE = 0.1
"""Square metres of the Gaussian that weights the second stage."""


@dataclass(frozen=True)
class TwoStageMapping:
    """One first stage and the second stage that follows it.

    Attributes:
        now, previous: tokens of two original scenes, 0.5 s apart.
        second: pairs of synthetic tokens, the later and the earlier one, 0.5 s apart; at least one.
    """

    now: str
    previous: str
    second: tuple[tuple[str, str], ...]

    def __post_init__(self) -> None:
        if not self.second:
            raise ValueError(f"TwoStageMapping.second: is empty for token {self.now!r}")


@dataclass(frozen=True)
class TwoStage:
    """The table.

    Attributes:
        rows: rows by token, values of `COLUMNS`; NaN for failed tokens.
        synthetic: whether the scene belongs to the second stage, by token.
        stage_one, stage_two: means of `COLUMNS` over both groups of all mappings.
        combined: EPDMS: mean over mappings of the mean of both groups' products.
        valid: whether all mappings could be scored; those with a failed token are left out.
    """

    rows: Mapping[str, Mapping[str, float]]
    synthetic: Mapping[str, bool]
    stage_one: Mapping[str, float]
    stage_two: Mapping[str, float]
    combined: float
    valid: bool


def second_stage_weights(endpoint: ArrayLike, starts: ArrayLike) -> Array:
    """Weights (n,) of synthetic scenes that sum to 1: Gaussian in their distance to the endpoint.

    exp(-d^2 / (2 * 0.1 m^2)); equal where all are so far away that they vanish.

    Args:
        endpoint: (2,) end of the first stage's plan.
        starts: (n, 2) start positions of the synthetic scenes.
    """
    offset = np.asarray(starts, np.float64) - np.asarray(endpoint, np.float64)
    weights = np.exp(-(offset**2).sum(axis=-1) / (2 * _VARIANCE))
    total = float(weights.sum())
    if np.isnan(total) or np.isclose(total, 0.0):
        return np.full(len(weights), 1 / len(weights))
    return np.asarray(weights / total)


def two_stage(scores: Sequence[TokenScore], mappings: Sequence[TwoStageMapping]) -> TwoStage:
    """Aggregate the scores of all tokens as NAVSIM does.

    A failed token makes its groups NaN, and they are left out of the means. (NAVSIM's own script
    ends without a summary then.)

    Raises:
        ValueError: a mapping names a token without scores; a token is scored twice; the tokens of
            a pair are further apart than 0.55 s.
    """
    by_token = {one.token: one for one in scores}
    if len(by_token) < len(scores):
        raise ValueError("two_stage: two scores have the same token")
    rows: dict[str, dict[str, float]] = {one.token: _row(one, np.nan) for one in scores}
    firsts, seconds, products = [], [], []
    for mapping in mappings:
        pairs = ((mapping.now, mapping.previous), *mapping.second)
        for now, previous in pairs:
            for token in (now, previous):
                if token not in by_token:
                    raise ValueError(f"two_stage: token {token!r} was not scored")
            comfort = _extended_comfort(by_token[now], by_token[previous])
            for token in (now, previous):
                rows[token] = _row(by_token[token], comfort)
        groups = []
        for i, token in enumerate((mapping.now, mapping.previous)):
            followers = [pair[i] for pair in mapping.second]
            weights = second_stage_weights(
                by_token[token].endpoint, [by_token[key].start for key in followers]
            )
            second = weights @ np.array([_values(rows[key]) for key in followers])
            firsts.append(_values(rows[token]))
            seconds.append(second)
            groups.append(firsts[-1] * second)
        products.append((groups[0] + groups[1]) / 2)
    stages = [dict(zip(COLUMNS, _mean(part), strict=True)) for part in (firsts, seconds)]
    combined = dict(zip(COLUMNS, _mean(products), strict=True))
    valid = not np.isnan(np.array(products)).any()
    synthetic = {one.token: one.synthetic for one in scores}
    return TwoStage(rows, synthetic, stages[0], stages[1], combined[_SCORE], valid)


def write_two_stage(table: TwoStage, path: Path) -> None:
    """Write the table as NAVSIM's CSV: one row a token, then the three rows of the summary.

    Sub-metrics stand in the columns of their stage; the rows of the summary are called
    `extended_pdm_score_stage_one`, `_stage_two` and `_combined`. NaN is an empty cell.
    """
    parts = [f"{name}_{stage}" for stage in SUMMARY[:2] for name in COLUMNS if name != _SCORE]
    lines: list[list[object]] = [["", "token", "valid", *parts, _SCORE]]

    def add(token: str, valid: bool, values: Mapping[str, float], score: float) -> None:
        cells = [values.get(part, np.nan) for part in (*parts, _SCORE)]
        cells[-1] = score
        shown = ["" if np.isnan(cell) else repr(float(cell)) for cell in cells]
        lines.append([len(lines) - 1, token, valid, *shown])

    for token, row in table.rows.items():
        stage = SUMMARY[table.synthetic[token]]
        values = {f"{name}_{stage}": value for name, value in row.items()}
        add(token, not np.isnan(row["ego_progress"]), values, row[_SCORE])
    both = dict(zip(SUMMARY[:2], (table.stage_one, table.stage_two), strict=True))
    named = {stage: {f"{k}_{stage}": v for k, v in both[stage].items()} for stage in both}
    for stage in SUMMARY[:2]:
        add(f"extended_pdm_score_{stage}", table.valid, named[stage], both[stage][_SCORE])
    everything = {**named["stage_one"], **named["stage_two"]}
    add("extended_pdm_score_combined", table.valid, everything, table.combined)
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    with atomic_file(path) as partial:
        partial.write_text(text.getvalue())


def _row(one: TokenScore, comfort: float) -> dict[str, float]:
    if one.plan is None:
        return dict.fromkeys(COLUMNS, np.nan)
    values = {name: float(getattr(one.plan.scores, key)) for name, key in _FIELDS.items()}
    return {**values, _COMFORT: comfort, _SCORE: float(one.plan.scores.total(comfort))}


def _values(row: Mapping[str, float]) -> Array:
    return np.array([row[name] for name in COLUMNS])


def _extended_comfort(now: TokenScore, previous: TokenScore) -> float:
    if now.plan is None or previous.plan is None:
        return np.nan
    interval = now.start_s - previous.start_s
    return extended_comfort(now.plan.states, previous.plan.states, interval)


def _mean(rows: Sequence[Array]) -> Array:
    """Means of the columns over the rows that are not NaN there; NaN where there are none."""
    known = ~np.isnan(rows)
    total, count = np.where(known, rows, 0.0).sum(axis=0), known.sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
