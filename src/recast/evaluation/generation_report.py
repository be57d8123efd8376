"""The results of a generation study in files and on the terminal, and the paper's to set beside.

The paper's (RECAST, section 5, Q3) are of its held-out RECAR vehicles and the published weights; on
another set they say what to expect of the order, not of the values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from rich.table import Table

from recast.evaluation.generation_summary import (
    STUDY_COLUMNS,
    StudyBlock,
    StudyDifference,
    StudyRow,
)
from recast.evaluation.pairs import Bootstrap
from recast.evaluation.table import rounded

PAPER_COLUMNS = ("psnr", "ssim", "lpips", "clip", "fd_inception", "fd_dino")
"""Scores in the paper's order, keys of `STUDY_COLUMNS`."""
PAPER_ROWS: Mapping[str, tuple[float, ...]] = {
    "Real3D": (13.19, 0.5691, 0.3223, 68.17, 91.196, 1282.01),
    "LN3Diff": (18.95, 0.8843, 0.1105, 63.03, 93.288, 1455.05),
    "3DTopia-XL": (15.54, 0.8085, 0.1817, 59.90, 166.294, 1299.59),
    "SAR3D": (15.39, 0.8231, 0.1588, 66.55, 64.042, 746.99),
    "Asset Harvester": (19.22, 0.8792, 0.1044, 78.29, 38.368, 183.08),
    "TRELLIS": (21.02, 0.9077, 0.0603, 78.22, 9.788, 43.89),
    "Stage I only": (22.90, 0.9178, 0.0534, 78.30, 8.176, 36.94),
    "both stages": (22.90, 0.9179, 0.0532, 78.38, 7.992, 36.47),
}
"""Scores by name of the row, in the order of `PAPER_COLUMNS`. The last three are the ablation."""
_PLACED = {
    "views": "by the clean conditioning view, as `recast eval actor` places them",
    "canonical": "by the model's own forward axis, scaled by the length of the box",
}
_SEEN = {
    "set": "in the photographs' own cameras and size",
    "orbit": "at 512 x 512 pixels and 40 degrees, twice the longest side of the box away, in the "
    "direction of the photograph, which is scaled about its centre",
}


def published(row: str) -> dict[str, float]:
    """Scores of a row of the paper, by key of `STUDY_COLUMNS`."""
    return dict(zip(PAPER_COLUMNS, PAPER_ROWS[row], strict=True))


@dataclass(frozen=True)
class StudyFacts:
    """What was studied, in plain values that do not depend on where files lie.

    Attributes:
        set: name of the folder.
        models: by name, last part of the path or name of the generator, and hash of its content.
        seed: of everything random.
        placement: see `recast.evaluation.generation_cell`.
        perturbations: the configuration; None where all inputs were clean.
        measures: weights that were given, as `models`.
        samples: of the bootstrap.
        targets: see `recast.evaluation.cases`.
        beside: rows of the paper by name of the row they stand beside.
    """

    set: str
    models: Mapping[str, Mapping[str, str]]
    seed: int
    placement: str
    perturbations: Mapping[str, Any] | None
    measures: Mapping[str, Mapping[str, str]]
    samples: int
    targets: str = "set"
    beside: Mapping[str, str] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def study_json(facts: StudyFacts, blocks: Sequence[StudyBlock]) -> dict[str, Any]:
    """All results as plain data, rounded to six decimals."""
    data: dict[str, Any] = rounded(
        {"version": 1, **facts.to_json(), "blocks": [_block_json(block) for block in blocks]}
    )
    return data


def study_markdown(facts: StudyFacts, blocks: Sequence[StudyBlock]) -> str:
    """Tables and paired differences for people."""
    lines = [f"# Generation study on {facts.set}", ""]
    for block in blocks:
        lines += _block_markdown(block)
    if facts.beside:
        lines += _paper_markdown(blocks[0], facts.beside)
    lines += ["## How to read it", ""]
    lines += [f"- {note}" for note in _notes(facts, blocks)]
    return "\n".join(lines) + "\n"


def study_table(block: StudyBlock) -> Table:
    """A line for every model."""
    table = Table(title=_title(block))
    table.add_column("model")
    table.add_column("made", justify="right")
    keys = list(block.rows[0].scores)
    for key in keys:
        table.add_column(_heading(key), justify="right")
    for row in block.rows:
        cells = [STUDY_COLUMNS[key].shown(row.scores[key]) for key in keys]
        table.add_row(row.model, str(row.made), *cells)
    return table


def paper_table(block: StudyBlock, beside: Mapping[str, str]) -> Table:
    """Scores in the paper's columns, and in brackets what the paper has."""
    table = Table(title="Beside the paper: here (there)")
    table.add_column("model")
    table.add_column("paper's row")
    for key in PAPER_COLUMNS:
        table.add_column(_heading(key), justify="right")
    for cells in _paper_cells(block, beside):
        table.add_row(*cells)
    return table


def differences_table(block: StudyBlock) -> Table:
    """A line for every pair of consecutive models and every score."""
    table = Table(title=f"Paired differences, {block.condition} inputs")
    for heading in ("difference", "score", "mean", "interval", "better"):
        table.add_column(heading, justify="left" if heading == "difference" else "right")
    for one in block.differences:
        mean, interval = _shown_interval(one)
        table.add_row(
            f"{one.candidate} - {one.baseline}",
            _heading(one.score),
            mean,
            interval,
            one.better or "undecided",
        )
    return table


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
                **_interval_json(one.interval),
                "better": one.better,
            }
            for one in block.differences
        ],
        "vehicles": block.vehicles,
    }


def _interval_json(interval: Bootstrap) -> dict[str, float]:
    return {
        "mean": interval.point,
        "low": interval.low,
        "high": interval.high,
        "level": interval.level,
        "std": interval.std,
    }


def _block_markdown(block: StudyBlock) -> list[str]:
    keys = list(block.rows[0].scores)
    best = {key: _best(block.rows, key) for key in keys}
    lines = [f"## {_title(block)}", ""]
    lines.append("| model | made | " + " | ".join(_heading(key) for key in keys) + " |")
    lines.append("|---|---:|" + "---:|" * len(keys))
    for row in block.rows:
        cells = [STUDY_COLUMNS[key].shown(row.scores[key]) for key in keys]
        shown = [
            f"**{cell}**" if cell == best[key] and len(block.rows) > 1 else cell
            for key, cell in zip(keys, cells, strict=True)
        ]
        lines.append(f"| {row.model} | {row.made} | " + " | ".join(shown) + " |")
    lines.append("")
    if block.differences:
        level = f"{100 * block.differences[0].interval.level:g} %"
        lines += [
            f"| difference | score | mean | {level} interval | better |",
            "|---|---|---:|---:|---|",
        ]
        for one in block.differences:
            mean, interval = _shown_interval(one)
            lines.append(
                f"| {one.candidate} - {one.baseline} | {_heading(one.score)} | {mean} | {interval} "
                f"| {one.better or 'undecided'} |"
            )
        lines.append("")
    for model, failed in block.failures.items():
        lines += [f"- {model} did not make {id}: {reason}" for id, reason in failed.items()]
    return [*lines, ""] if lines[-1] else lines


def _paper_markdown(block: StudyBlock, beside: Mapping[str, str]) -> list[str]:
    lines = ["## Beside the paper: here (there)", ""]
    headings = ["model", "paper's row", *map(_heading, PAPER_COLUMNS)]
    lines += ["| " + " | ".join(headings) + " |", "|---|---|" + "---:|" * len(PAPER_COLUMNS)]
    lines += ["| " + " | ".join(cells) + " |" for cells in _paper_cells(block, beside)]
    return [
        *lines,
        "",
        "The paper's figures are of its held-out RECAR vehicles and the published "
        "weights, ours of the set above: compare the order of rows. A dash: not run or not "
        "measured here.",
        "",
    ]


def _paper_cells(block: StudyBlock, beside: Mapping[str, str]) -> list[list[str]]:
    """Name, the paper's row, and a cell for each of the paper's columns."""
    ours = {row.model: row.scores for row in block.rows}
    found = []
    for name in [*beside, *(name for name in ours if name not in beside)]:
        theirs = published(beside[name]) if name in beside else {}
        scores = ours.get(name, {})
        cells = [name, beside.get(name, "-")]
        for key in PAPER_COLUMNS:
            column = STUDY_COLUMNS[key]
            here = column.shown(scores[key]) if key in scores else "-"
            cells.append(f"{here} ({column.shown(theirs[key])})" if key in theirs else here)
        found.append(cells)
    return found


def _notes(facts: StudyFacts, blocks: Sequence[StudyBlock]) -> list[str]:
    keys = set(blocks[0].rows[0].scores)
    pictures = ", ".join(f"{block.views} {block.condition}" for block in blocks)
    notes = [
        "All models get the same picture of a vehicle, one view by seed that is no target; views "
        f"are compared before black {_SEEN[facts.targets]}. Scores are means over the vehicles "
        "that every model made, each vehicle counting the same.",
        f"Vehicles are placed {_PLACED[facts.placement]}; pictures that were drawn elsewhere are "
        "taken as they are.",
        f"Intervals: percentile bootstrap over vehicles, {facts.samples} samples; `better` names "
        "the model that the interval favours, if it does not hold zero. They tell about other "
        "vehicles, not about other trainings or seeds.",
        f"FD is the Frechet distance to the photographs of the same views ({pictures}). Over few "
        "pictures it is too large, the more so the more dimensions the features have: compare it "
        "within a table, not with other studies.",
        "Toy features are 128 handcrafted numbers (colours and gradients in 4 x 4 cells), a "
        "stand-in that tells colour and layout; their figures compare with no published ones.",
    ]
    if facts.perturbations is not None:
        notes.append(
            "Perturbed inputs are never left clean, whatever rho_clean says; all models get the "
            "same perturbed picture."
        )
    if "psnr_vehicle" in keys:
        notes.append("PSNR vehicle is over the pixels of either outline.")
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


def _shown_interval(one: StudyDifference) -> tuple[str, str]:
    column = STUDY_COLUMNS[one.score]
    decimals = column.decimals + 1
    low, high = one.interval.low, one.interval.high
    return f"{one.interval.point:+.{decimals}f}", f"[{low:+.{decimals}f}, {high:+.{decimals}f}]"
