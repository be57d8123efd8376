"""The EPDMS of one plan: against PDM-Closed's plan from the same state, both driven for 4 s."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, BoolArray
from recast.core.errors import InputError
from recast.core.files import atomic_file
from recast.dynamics import PACIFICA, VehicleParameters, plan_to_poses, track
from recast.dynamics import state as ego
from recast.dynamics.tracker import PDM_REFERENCE
from recast.planning.map import PlannerMap
from recast.planning.pdm import (
    ExtendedScores,
    Obstacle,
    PdmClosed,
    PdmConfig,
    extended_comfort,
    observed,
    score_extended,
)
from recast.planning.pdm.scorer import STEPS

Traffic = Callable[[Array], ArrayLike]
"""Poses (n, 41, 3) of the obstacles' box centres, 0.1 s apart, for the ego's states (41, 11); NaN
while an obstacle is not there."""

_HORIZON = 4.0


@dataclass(frozen=True)
class PlanSituation:
    """What a plan is judged in.

    Attributes:
        state: (11,) state of the ego now.
        planner_map, route: the map, and the ids of the route's blocks in order.
        obstacles: n road users and objects now.
        traffic: motion of the road users and objects, which may depend on what the ego does.
        red: state of the lights by id of a connector, (41,) whether its light is red.
        history: (H, 11) states before now, 0.1 s apart; None for none, which makes HC 1.
    """

    state: Array
    planner_map: PlannerMap
    route: tuple[str, ...]
    obstacles: tuple[Obstacle, ...] = ()
    traffic: Traffic = lambda states: np.zeros((0, STEPS + 1, 3))
    red: Mapping[str, BoolArray] = field(default_factory=dict)
    history: Array | None = None
    vehicle: VehicleParameters = PACIFICA


@dataclass(frozen=True)
class PlanScore:
    """What a plan scored.

    Attributes:
        scores: its sub-metrics, () each; EC needs a second plan.
        states: (41, 11) states of the ego that result from following the plan.
    """

    scores: ExtendedScores
    states: Array


def score_plan(situation: PlanSituation, waypoints: ArrayLike, interval: float = 0.1) -> PlanScore:
    """Drive a plan and PDM-Closed's with NAVSIM's tracker, and score the plan.

    Args:
        waypoints: (N, 3) x, y, heading of the rear axle in the ego frame at `interval`,
            2 `interval`, ... seconds.

    Raises:
        InputError: PDM-Closed cannot plan here: the map has no lanes, or the ego is far from the
            route.
        ValueError: the plan ends before 4 s.
    """
    pdm, reference = _pdm_closed(situation)
    states = _driven(
        situation, np.stack([reference, planned_poses(situation, waypoints, interval)])
    )
    return PlanScore(_scores(situation, pdm, states, states[1], situation.history).at(1), states[1])


def score_human(situation: PlanSituation, waypoints: ArrayLike, interval: float = 0.1) -> PlanScore:
    """Score what the human drove, as NAVSIM's human filter does: alone, and without a history.

    Args, Raises: as for `score_plan`.
    """
    pdm, _ = _pdm_closed(situation)
    states = _driven(situation, planned_poses(situation, waypoints, interval)[None])
    return PlanScore(_scores(situation, pdm, states, states[0], None).at(0), states[0])


def human_filtered(agent: ExtendedScores, human: ExtendedScores) -> ExtendedScores:
    """The agent's sub-metrics, 1 where the human's are 0."""
    return ExtendedScores(
        *(
            np.where(getattr(human, one.name) == 0.0, 1.0, getattr(agent, one.name))
            for one in fields(agent)
        )
    )


def planned_poses(situation: PlanSituation, waypoints: ArrayLike, interval: float) -> Array:
    """World poses (41, 3) at 0, 0.1, ..., 4 s of a plan; linear between its own, as in NAVSIM.

    Args, Raises: as for `score_plan`.
    """
    poses = plan_to_poses(situation.state[ego.POSE], waypoints)
    known = interval * np.arange(len(poses))
    if known[-1] < _HORIZON - 1e-6:
        raise ValueError(
            f"planned_poses: the plan ends at {known[-1]:g} s, {_HORIZON:g} s are needed"
        )
    times = np.linspace(0.0, _HORIZON, STEPS + 1)
    columns = (poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2]))
    return np.stack([np.interp(times, known, column) for column in columns], axis=-1)


def _pdm_closed(situation: PlanSituation) -> tuple[PdmClosed, Array]:
    """PDM-Closed with its route and centreline, and its plan: world poses (41, 3)."""
    settings = PdmConfig(reference_quirks=True)
    pdm = PdmClosed(situation.planner_map, situation.route, situation.vehicle, settings)
    red_now = [lane for lane, red in situation.red.items() if red[0]]
    found = pdm.plan(situation.state, situation.obstacles, red_now)
    return pdm, found.trajectory[: STEPS + 1]


def _driven(situation: PlanSituation, poses: Array) -> Array:
    start = np.broadcast_to(situation.state, (len(poses), ego.SIZE))
    return track(start, poses, STEPS, PDM_REFERENCE, situation.vehicle)


def _scores(
    situation: PlanSituation, pdm: PdmClosed, states: Array, driven: Array, history: Array | None
) -> ExtendedScores:
    lanes = situation.planner_map.lanes
    on_route = situation.planner_map.lanes_of(pdm.route)
    lights = [(k, lanes[k].polygon, red) for k, red in situation.red.items() if k in on_route]
    return score_extended(
        states,
        observed(situation.obstacles, situation.traffic(driven), lights),
        pdm.centreline,
        situation.planner_map,
        on_route,
        situation.vehicle,
        history,
    )


@dataclass(frozen=True)
class SubmittedScene:
    """One scene for which plans are submitted.

    Attributes:
        token: its id.
        synthetic: whether the scene belongs to the second stage.
        start_s: seconds at which the plan begins, on the log's clock.
        situation: what the plan is judged in.
        human: (N, 3) what the human drove, as `score_plan`'s waypoints at 0.1 s; None for none. It
            filters the scores of original scenes.
    """

    token: str
    synthetic: bool
    start_s: float
    situation: PlanSituation
    human: Array | None = None


@dataclass(frozen=True)
class TokenScore:
    """What the plan of one token scored.

    Attributes:
        token, synthetic, start_s: the scene's fields of the same names, see `SubmittedScene`.
        start, endpoint: (2,) world x, y of the rear axle now, and where the plan itself ends.
        plan: its scores, filtered; None if there is no valid plan.
        reason: why there is none.
    """

    token: str
    synthetic: bool
    start_s: float
    start: Array
    endpoint: Array
    plan: PlanScore | None
    reason: str | None = None


def score_scene(
    scene: SubmittedScene, waypoints: ArrayLike | None, interval: float = 0.5
) -> TokenScore:
    """Score the plan submitted for a scene; one that cannot be scored is failed, not an error.

    Args:
        waypoints: waypoints of the plan, as for `score_plan`; None where nothing was submitted.
        interval: seconds between waypoints, as for `score_plan`.
    """
    start = scene.situation.state[:2]
    failed = TokenScore(
        scene.token, scene.synthetic, scene.start_s, start, np.full(2, np.nan), None
    )
    if waypoints is None:
        return replace(failed, reason="no plan was submitted")
    try:
        plan = score_plan(scene.situation, waypoints, interval)
        if scene.human is not None and not scene.synthetic:
            human = score_human(scene.situation, scene.human)
            plan = replace(plan, scores=human_filtered(plan.scores, human.scores))
    except (InputError, ValueError) as error:
        return replace(failed, reason=str(error))
    end = planned_poses(scene.situation, waypoints, interval)[-1, :2]
    return replace(failed, endpoint=end, plan=plan)


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
