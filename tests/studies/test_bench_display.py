"""The tables on the terminal: whole at 80 columns, and they say over what a figure is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
from rich.console import Console
from rich.table import Table

from recast.metrics import COLUMNS
from recast.runs.display import results_tables
from recast.studies.closed_loop import differences_table, grid_table, parts_table, truth_table
from recast.studies.grid import GridRow, arm_summaries, paired_summaries
from recast.studies.verdicts import VerdictPart, agreements, noise_floors, part_losses

STEPS = tuple(range(0, 160, 5))


def row(number: int, arm: str, value: float, steps: int = 160, **scores: float | None) -> GridRow:
    values = {**dict.fromkeys(COLUMNS, value), "ttc": 4.0 * value, **scores}
    return GridRow(
        f"scene {number}",
        None,
        None,
        "cut-in",
        "a",
        arm,
        "p",
        steps_run=steps,
        plan_steps=tuple(step for step in STEPS if step < steps),
        cut_reason=None if steps == 160 else "the log ends",
        scores=values,
        shorter={60: values},
    )


def grid() -> list[GridRow]:
    rows = []
    for number in range(12):
        rows += [
            row(number, "native", float(number % 2)),
            row(number, "replaced", float(number > 3), 60 if number == 5 else 160),
            row(number, "oracle", 1.0, dac=None if number == 7 else 1.0),
        ]
    rows[4] = rows[4].failed("ValueError", "NaN at waypoint 3")
    return rows


def shown(table: Table) -> list[str]:
    console = Console(width=80, record=True)
    console.print(table)
    lines = console.export_text().split("\n")
    assert not any("\u2026" in line for line in lines)
    return lines


def line_of(lines: Sequence[str], *words: str) -> int:
    return next(i for i, line in enumerate(lines) if all(word in line.split() for word in words))


def test_the_table_says_what_was_scored_failed_and_cut() -> None:
    lines = shown(grid_table(arm_summaries(grid(), 100, 0), "a title of the table"))
    first = line_of(lines, "replaced")
    assert [line.strip().split("  ")[0] for line in lines[first : first + 5]] == [
        "replaced",
        "11 of 12",
        "332 plans",
        "1 failed",
        "1 cut",
    ]
    assert "8/11" in lines[first + 1].split()
    oracle = line_of(lines, "oracle")
    assert "11/11" in lines[oracle + 1].split()  # of 12: one has no map


def test_collisions_that_the_ego_is_to_blame_for_stand_below_nc() -> None:
    rows = [row(n, "native", float(n > 3), nc_at_fault=float(n > 0)) for n in range(12)]
    lines = shown(grid_table(arm_summaries(rows, 100, 0), "a title"))
    first = line_of(lines, "native")
    assert "8/12" in lines[first + 1].split()
    assert "1 at fault" in lines[first + 3]


def test_differences_and_verdicts_say_how_many_pairs_and_plans() -> None:
    lines = shown(differences_table(paired_summaries(grid(), "native", 100, 0)))
    at = line_of(lines, "replaced", "NC")
    assert lines[at].split()[-2:] == ["11/12", "332"]
    assert lines[at + 1].split() == ["1", "cut"]
    assert lines[line_of(lines, "oracle", "DAC")].split()[-2:] == ["11/12", "352"]
    assert line_of(lines, "replaced", "driven")
    lines = shown(truth_table(agreements(grid(), "oracle", 100, 0)))
    assert lines[line_of(lines, "replaced")].split()[-2:] == ["11/12", "332"]


def test_long_names_of_arms_take_nothing_from_the_figures() -> None:
    few = grid()[:18]  # six scenes: the exact bootstrap of twelve takes seconds
    rows = [replace(one, arm=one.arm.replace("replaced", "omnire+a-long-name")) for one in few]
    tables = [
        grid_table(arm_summaries(rows, 100, 0), "a title"),
        differences_table(paired_summaries(rows, "native", 100, 0)),
        truth_table(agreements(rows, "oracle", 100, 0)),
    ]
    for table in tables:
        assert line_of(shown(table), "omnire+")


def test_agreement_stands_beside_the_noise_floor() -> None:
    noisy = [row(n, "oracle:seed", float(n > 0)) for n in range(12)]
    rows = [replace(one, arm=one.arm.replace("replaced", "omnire+a-name")) for one in grid()]
    rows += noisy
    [floor] = noise_floors(rows, "oracle", ["oracle:seed"], 100, 0)
    lines = shown(truth_table(agreements(rows, "oracle", 100, 0), floor))
    at = line_of(lines, "omnire+")
    assert lines[at].split()[1:4] == ["8/11", "11/12", "0.79"]
    assert lines[at + 1].split()[1:5] == ["72.7", "%", "91.7", "%"]
    assert lines[at].split()[-2:] == ["11/12", "332"]


def test_the_parts_of_a_disagreement() -> None:
    rows = [replace(one, arm=one.arm.replace("replaced", "omnire+a-long-name")) for one in grid()]
    parts = [
        VerdictPart("no vehicle", "oracle", "omnire+a-long-name"),
        VerdictPart("light", "oracle", "native"),
    ]
    lines = shown(parts_table(part_losses(rows, "oracle", parts, 100, 0)))
    first = lines[line_of(lines, "oracle", "vehicle")].split()
    assert first[:6] == ["oracle", "no", "vehicle", "omnire+", "11,", "8"]
    assert first[6:8] == ["11", "+27.3"]
    assert "12" in lines[line_of(lines, "light")].split()


def test_a_run_s_table_does_too() -> None:
    rows = [line.row.to_json() for line in arm_summaries(grid(), 10, 0)]
    [table] = results_tables(rows)
    lines = shown(table)
    at = line_of(lines, "replaced")
    assert lines[at].split()[1:5] == ["11", "of", "12", "332"]
    assert [lines[at + i].split()[:2] for i in (1, 2)] == [["1", "failed"], ["1", "cut"]]
    oracle = line_of(lines, "oracle")
    assert lines[oracle + 1].split() == ["of", "11"]


@pytest.mark.parametrize("name", ["com_driven", "nc", "com"])
def test_headings_are_narrow(name: str) -> None:
    assert max(map(len, COLUMNS[name].heading.split("\n"))) <= 8
