"""The table of a generation study, and how sure it is that one model is better than another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from rich.table import Table

from recast.metrics.actor_scores import ACTOR_COLUMNS, ActorColumn, mean_scores
from recast.metrics.frechet import frechet_distance
from recast.metrics.perceptual import FEATURE_KINDS
from recast.metrics.table import SAMPLES, Bootstrap, cluster_bootstrap, rounded
from recast.studies.generation.cells import StudyCell
from recast.studies.generation.rows import PAPER_COLUMNS, PAPER_ROWS

STUDY_COLUMNS: Mapping[str, ActorColumn] = {
    **ACTOR_COLUMNS,
    "toy": ActorColumn("toy distance", "", False, 4),
    "fd_inception": ActorColumn("FD Inception", "", False, 3),
    "fd_dino": ActorColumn("FD DINOv2", "", False, 2),
    "fd_toy": ActorColumn("FD toy", "", False, 4),
}
"""Scores in the order of the table. Those that begin with `fd_` are of all pictures together."""


@dataclass(frozen=True)
class StudyRow:
    """A model's line of a table.

    Attributes:
        made: vehicles that it made, of all it was asked for.
        scores: means over the block's vehicles, each counting the same, and Frechet distances.
    """

    model: str
    made: int
    scores: Mapping[str, float]


@dataclass(frozen=True)
class StudyDifference:
    """Candidate minus baseline over the block's vehicles, which are drawn whole.

    Attributes:
        candidate, baseline: names of models.
        score: key of `STUDY_COLUMNS`.
        interval: the mean difference and its interval.
    """

    candidate: str
    baseline: str
    score: str
    interval: Bootstrap

    @property
    def better(self) -> str | None:
        """The model that the interval says is better; None where it holds zero."""
        if self.interval.low <= 0.0 <= self.interval.high:
            return None
        higher = self.candidate if self.interval.low > 0 else self.baseline
        lower = self.baseline if self.interval.low > 0 else self.candidate
        return higher if STUDY_COLUMNS[self.score].higher else lower


@dataclass(frozen=True)
class StudyBlock:
    """One condition, such as clean inputs.

    Attributes:
        identities: vehicles that every model made; all figures are over these.
        views: pictures that they were compared in.
        failures: reason why a vehicle could not be made, by model and vehicle.
        vehicles: mean scores over a vehicle's views, by vehicle and model.
    """

    condition: str
    identities: tuple[str, ...]
    views: int
    failures: Mapping[str, Mapping[str, str]]
    rows: tuple[StudyRow, ...]
    differences: tuple[StudyDifference, ...]
    vehicles: Mapping[str, Mapping[str, Mapping[str, float]]]


def summarize(
    condition: str,
    cells: Mapping[str, Sequence[StudyCell]],
    truth: Mapping[str, StudyCell],
    *,
    seed: int = 0,
    samples: int = SAMPLES,
) -> StudyBlock:
    """Table and paired differences of one condition.

    Args:
        cells: cells by model, one for every vehicle.
        truth: the photographs' features, by vehicle.
        seed: seed of the bootstrap; every difference sees the same draws.
        samples: number of bootstrap samples.

    Raises:
        ValueError: no vehicle was made by every model.
    """
    failures = {
        model: {cell.id: cell.failure for cell in mine if cell.failure is not None}
        for model, mine in cells.items()
    }
    identities = tuple(id for id in truth if not any(id in failed for failed in failures.values()))
    if not identities:
        raise ValueError(
            f"summarize: there is no vehicle that every model made from {condition} inputs"
        )
    chosen = {
        model: {cell.id: cell for cell in mine if cell.id in set(identities)}
        for model, mine in cells.items()
    }
    scored = {
        model: {id: view_scores(mine[id], truth[id]) for id in identities}
        for model, mine in chosen.items()
    }
    vehicles = {id: {model: mean_scores(scored[model][id]) for model in cells} for id in identities}
    rows = []
    for model in cells:
        means = mean_scores([vehicles[id][model] for id in identities])
        means |= _frechet(
            [chosen[model][id] for id in identities], [truth[id] for id in identities]
        )
        ordered = {key: means[key] for key in STUDY_COLUMNS if key in means}
        rows.append(StudyRow(model, len(cells[model]) - len(failures[model]), ordered))
    differences = [
        StudyDifference(candidate, baseline, key, interval)
        for baseline, candidate in pairwise(cells)
        for key in STUDY_COLUMNS
        if key in vehicles[identities[0]][candidate]
        for interval in [_interval(scored[candidate], scored[baseline], key, seed, samples)]
    ]
    views = sum(len(truth[id].views) for id in identities)
    return StudyBlock(
        condition, identities, views, failures, tuple(rows), tuple(differences), vehicles
    )


def view_scores(cell: StudyCell, truth: StudyCell) -> list[dict[str, float]]:
    """The scores of every view that a cell holds and those by features."""
    found = [dict(scores) for scores in cell.scores]
    for name, features in cell.features.items():
        kind = FEATURE_KINDS[name]
        if kind.score is None or kind.compare is None:
            continue
        for scores, one, other in zip(found, features, truth.features[name], strict=True):
            scores[kind.score] = kind.compare(one.astype(np.float64), other.astype(np.float64))
    return found


def _frechet(cells: Sequence[StudyCell], truth: Sequence[StudyCell]) -> dict[str, float]:
    """Distances between all pictures of a model and all photographs, where there are two."""
    found: dict[str, float] = {}
    for name in cells[0].features:
        column = FEATURE_KINDS[name].frechet
        drawn = np.concatenate([cell.features[name] for cell in cells])
        if column is not None and len(drawn) > 1:
            photographs = np.concatenate([cell.features[name] for cell in truth])
            found[column] = frechet_distance(drawn, photographs)
    return found


def _interval(
    candidate: Mapping[str, Sequence[Mapping[str, float]]],
    baseline: Mapping[str, Sequence[Mapping[str, float]]],
    key: str,
    seed: int,
    samples: int,
) -> Bootstrap:
    # by vehicle, not by view: a vehicle counts the same however many views it has
    pairs = [
        np.mean([one[key] for one in candidate[id]]) - np.mean([one[key] for one in baseline[id]])
        for id in candidate
    ]
    return cluster_bootstrap(pairs, np.random.default_rng(seed), samples)


_PLACED = {
    "views": "by the clean conditioning view, as `recast eval actor` places them",
    "canonical": "by the model's own forward axis, scaled by the length of the box",
}
_SEEN = {
    "set": "in the photographs' own cameras and size",
    "orbit": "at 512 x 512 pixels and 40 degrees, twice the longest side of the box away, in the "
    "direction of the photograph, which is scaled about its centre",
}


def study_json(facts: Mapping[str, Any], blocks: Sequence[StudyBlock]) -> dict[str, Any]:
    """All results as plain data, rounded to six decimals.

    Args:
        facts: what was studied, see `recast.studies.generation.study`.
    """
    return rounded({"version": 1, **facts, "blocks": [_block_json(block) for block in blocks]})


def study_markdown(facts: Mapping[str, Any], blocks: Sequence[StudyBlock]) -> str:
    """Tables and paired differences for people."""
    lines = [f"# Generation study on {facts['set']}", ""]
    for block in blocks:
        lines += _block_markdown(block)
    if facts["beside"]:
        lines += _paper_markdown(blocks[0], facts["beside"])
    lines += ["## How to read it", ""]
    lines += [f"- {note}" for note in _notes(facts, blocks)]
    return "\n".join(lines) + "\n"


def study_table(block: StudyBlock) -> Table:
    """A line for every model."""
    return _rich(_title(block), *_model_lines(block))


def paper_table(block: StudyBlock, beside: Mapping[str, str]) -> Table:
    """Scores in the paper's columns, and in brackets what the paper has."""
    return _rich("Compared with the paper: ours (paper)", *_paper_lines(block, beside))


def differences_table(block: StudyBlock) -> Table:
    """A line for every pair of consecutive models and every score."""
    return _rich(f"Paired differences, {block.condition} inputs", *_difference_lines(block))


_Lines = tuple[str, list[list[str]]]
"""Alignment of each column, l or r; headings, then rows."""


def _rich(title: str, align: str, lines: list[list[str]]) -> Table:
    table = Table(title=title)
    for heading, side in zip(lines[0], align, strict=True):
        table.add_column(heading, justify="left" if side == "l" else "right")
    for row in lines[1:]:
        table.add_row(*row)
    return table


def _markdown(align: str, lines: list[list[str]]) -> list[str]:
    rule = "|" + "".join("---|" if side == "l" else "---:|" for side in align)
    shown = [f"| {' | '.join(row)} |" for row in lines]
    return [shown[0], rule, *shown[1:]]


def _block_json(block: StudyBlock) -> dict[str, Any]:
    return {
        "condition": block.condition,
        "identities": list(block.identities),
        "views": block.views,
        "failures": block.failures,
        "rows": [asdict(row) for row in block.rows],
        "differences": [
            {
                "candidate": one.candidate,
                "baseline": one.baseline,
                "score": one.score,
                "mean": one.interval.point,
                **{name: getattr(one.interval, name) for name in ("low", "high", "level", "std")},
                "better": one.better,
            }
            for one in block.differences
        ],
        "vehicles": block.vehicles,
    }


def _block_markdown(block: StudyBlock) -> list[str]:
    align, table = _model_lines(block)
    for place, key in enumerate(block.rows[0].scores, start=2):
        best = _best(block.rows, key)
        for row in table[1:] if len(block.rows) > 1 else ():
            row[place] = f"**{best}**" if row[place] == best else row[place]
    lines = [f"## {_title(block)}", "", *_markdown(align, table), ""]
    if block.differences:
        lines += [*_markdown(*_difference_lines(block)), ""]
    for model, failed in block.failures.items():
        lines += [f"- {model} did not make {id}: {reason}" for id, reason in failed.items()]
    return [*lines, ""] if lines[-1] else lines


def _model_lines(block: StudyBlock) -> _Lines:
    keys = list(block.rows[0].scores)
    lines = [["model", "made", *map(_heading, keys)]]
    for row in block.rows:
        cells = [STUDY_COLUMNS[key].shown(row.scores[key]) for key in keys]
        lines.append([row.model, str(row.made), *cells])
    return "l" + "r" * (len(keys) + 1), lines


def _difference_lines(block: StudyBlock) -> _Lines:
    level = 100 * block.differences[0].interval.level if block.differences else 95
    lines = [["difference", "score", "mean", f"{level:g} % interval", "better"]]
    for one in block.differences:
        decimals = STUDY_COLUMNS[one.score].decimals + 1
        mean, low, high = (
            f"{value:+.{decimals}f}"
            for value in (one.interval.point, one.interval.low, one.interval.high)
        )
        names = f"{one.candidate} - {one.baseline}"
        better = one.better or "undecided"
        lines.append([names, _heading(one.score), mean, f"[{low}, {high}]", better])
    return "llrrl", lines


def _paper_markdown(block: StudyBlock, beside: Mapping[str, str]) -> list[str]:
    return [
        "## Compared with the paper: ours (paper)",
        "",
        *_markdown(*_paper_lines(block, beside)),
        "",
        "The paper's figures are for its held-out RECAR vehicles and the published weights, "
        "ours for the set above: compare only the order of rows. A dash means: not run or not "
        "measured here.",
        "",
    ]


def _paper_lines(block: StudyBlock, beside: Mapping[str, str]) -> _Lines:
    """Name, the paper's row, and a cell for each of the paper's columns."""
    ours = {row.model: row.scores for row in block.rows}
    lines = [["model", "paper's row", *map(_heading, PAPER_COLUMNS)]]
    for name in [*beside, *(name for name in ours if name not in beside)]:
        theirs = PAPER_ROWS[beside[name]] if name in beside else {}
        scores = ours.get(name, {})
        cells = [name, beside.get(name, "-")]
        for key in PAPER_COLUMNS:
            column = STUDY_COLUMNS[key]
            here = column.shown(scores[key]) if key in scores else "-"
            cells.append(f"{here} ({column.shown(theirs[key])})" if key in theirs else here)
        lines.append(cells)
    return "ll" + "r" * len(PAPER_COLUMNS), lines


def _notes(facts: Mapping[str, Any], blocks: Sequence[StudyBlock]) -> list[str]:
    keys = set(blocks[0].rows[0].scores)
    pictures = ", ".join(f"{block.views} {block.condition}" for block in blocks)
    notes = [
        "All models get the same image of a vehicle: one view, chosen by the seed, that is not a "
        f"target. Views are compared on a black background, {_SEEN[facts['targets']]}. Scores are "
        "means over the vehicles that every model made; each vehicle has the same weight.",
        f"Vehicles are placed {_PLACED[facts['placement']]}. Images that were drawn elsewhere are "
        "used as they are.",
        f"Intervals: percentile bootstrap over vehicles, {facts['samples']} samples. `better` "
        "names the model that the interval favours, if it excludes zero. The intervals cover other "
        "vehicles, not other training runs or seeds.",
        f"FD is the Frechet distance to the photographs of the same views ({pictures}). With few "
        "images it is too large, more so for features with more dimensions. Compare it within a "
        "table, not with other studies.",
        "Toy features are 128 handcrafted numbers (colours and gradients in 4 x 4 cells), a "
        "substitute that measures colour and layout. Do not compare them with published figures.",
    ]
    if facts["perturbations"] is not None:
        notes.append(
            "In the perturbed condition every input is perturbed, whatever `rho_clean` says. All "
            "models get the same perturbed image."
        )
    if "psnr_vehicle" in keys:
        notes.append("PSNR vehicle is computed over the pixels inside either outline.")
    return notes


def _title(block: StudyBlock) -> str:
    return (
        f"{block.condition.capitalize()} inputs: {len(block.identities)} vehicles, "
        f"{block.views} views"
    )


def _heading(key: str) -> str:
    column = STUDY_COLUMNS[key]
    unit = f" {column.unit}" if column.unit else ""
    return f"{column.label}{unit} {'↑' if column.higher else '↓'}"


def _best(rows: Sequence[StudyRow], key: str) -> str:
    column = STUDY_COLUMNS[key]
    values = [row.scores[key] for row in rows]
    return column.shown(max(values) if column.higher else min(values))
