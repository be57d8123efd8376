from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.metrics import rollout_metrics
from recast.reporting import ComparedRun, RolloutPart, ScenarioPart, write_comparison
from recast.reporting.compare import differing_settings, metric_lines, outcome_rows
from recast.simulation.rollout import RolloutFailure
from reporting.made_up_rollouts import HOSTILE, cut_in, straight_map
from support.report_pages import Page, digests

KEY = ("cut-in", "a", "idm-lane-follower")
ARMS = {"native": "Native", "recast": f"Replaced {HOSTILE}"}


def scenario(brakes: dict[str, float], sideways: float = 0.0) -> ScenarioPart:
    parts = []
    for arm, brake in brakes.items():
        rollout = cut_in(arm, steps=40, brake=brake, cut=False)
        actor = rollout.actor + np.array([0.0, sideways, 0.0, 0.0])
        ego = rollout.ego.copy()
        ego[0, 5] = 0.0  # the start is the same, whoever brakes from then on
        rollout = dataclasses.replace(rollout, actor=actor, ego=ego)
        parts.append(RolloutPart(arm, rollout, rollout_metrics(rollout, straight_map())))
    return ScenarioPart("Cut-in, setting a", "", tuple(parts))


def run(name: str, part: ScenarioPart, log: str = "one", **settings: object) -> ComparedRun:
    return ComparedRun(
        name,
        log,
        f"hash of {log}",
        "0",
        ARMS,
        {KEY: part},
        {"steps": 40, **settings},
        straight_map(),
    )


@pytest.fixture(scope="module")
def runs() -> list[ComparedRun]:
    arms = [{"name": "native", "refine": None}, {"name": "recast", "refine": True}]
    other = [arms[0], {"name": "recast", "refine": False}]
    return [
        run("first", scenario({"native": 0.0, "recast": 0.0}), arms=arms, seed=1),
        run("second", scenario({"native": 0.0, "recast": 2.0}), arms=other, seed=1),
        run(f"third {HOSTILE}", scenario({"native": 2.0}, sideways=0.5), "two", arms=arms),
    ]


def test_settings_that_differ_are_found_wherever_they_lie(runs: list[ComparedRun]) -> None:
    assert differing_settings(runs) == (
        ("arms.recast.refine", ("true", "false", "true")),
        ("seed", ("1", "1", "-")),
    )
    assert differing_settings(runs[:1] * 2) == ()


def test_differences_are_paired_where_the_scenario_is_the_same(runs: list[ComparedRun]) -> None:
    lines = {(line.label, line.sub): line for line in metric_lines(runs)}
    labels = [line.label for line in metric_lines(runs)]
    assert labels == [
        "A: Native",
        "B: Native",
        "B minus A",
        "C: Native",
        "C minus A",
        f"A: Replaced {HOSTILE}",
        f"B: Replaced {HOSTILE}",
        "B minus A",
    ]
    paired = lines["B minus A", "paired; mean over 1 of 1 pair, 8 plans each"]
    native, replaced = (line for line in metric_lines(runs) if line.label == "B minus A")
    assert paired is not None and [cell.text[:4] for cell in native.cells[:3]] == ["+0.0"] * 2 + [
        "+0.0"
    ]
    assert replaced.cells[0].text == "+100.0\u00a0points"  # NC: a contact, and none with brakes
    loose = lines["C minus A", "difference of the means: no scenario in common"]
    assert loose.cells[0].text == "+100.0\u00a0points"


def test_endings_tell_where_a_path_leaves_that_of_the_first_run(runs: list[ComparedRun]) -> None:
    native, replaced = outcome_rows(runs)
    assert [cell.path for cell in native.cells] == [
        None,
        "path within 0.5 m of A's path",
        "not compared: the scenario differs from A's",
    ]
    # 0.01 k (k - 1) > 0.5 at k = 8
    assert [cell.path for cell in replaced.cells] == [None, "path leaves A's path at 0.8 s", None]
    assert replaced.cells[0].outcome.text.startswith("contact at 2.3 s")
    assert replaced.cells[1].outcome.text.startswith("no contact")
    assert replaced.cells[2].outcome.text == "not requested"


def test_the_page_is_self_contained_and_tells_what_is_not_comparable(
    runs: list[ComparedRun], tmp_path: Path
) -> None:
    page = Page(write_comparison(runs, tmp_path / "out"))
    for words in (
        "3 runs compared",
        "C is a run on another log than A (two, not one)",
        "arms.recast.refine",
        "paired; mean over 1 of 1 pair",
        "path leaves A's path at 0.8 s",
        "the paths diverge: Native and Replaced",
        "contact: Native",
    ):
        assert words in page.text, words
    linked = {link for link in page.links() if not link.startswith("#")}
    assert linked == set(digests(tmp_path / "out")) - {"index.html"}
    raw = (tmp_path / "out/index.html").read_text(encoding="utf-8")
    assert "<script" not in raw and "http" not in raw
    write_comparison(runs, tmp_path / "again")
    assert digests(tmp_path / "again") == digests(tmp_path / "out")


def test_failures_and_missing_scenarios_are_rows_too(tmp_path: Path) -> None:
    failure = RolloutFailure("s", "native", "0", "cut-in", "a", KEY[2], "ValueError", HOSTILE)
    failed = run("failed", ScenarioPart("Cut-in", "", (RolloutPart("native", failure),)))
    empty = dataclasses.replace(run("empty", scenario({})), scenarios={})
    page = Page(
        write_comparison([run("a", scenario({"native": 0.0})), failed, empty], tmp_path / "o")
    )
    assert (
        "the rollout failed" in page.text
        and "C does not have these scenarios: cut-in, setting a" in page.text
    )
    assert "no rollout could be run" in page.text
    nothing = Page(write_comparison([empty, empty], tmp_path / "p"))
    assert "All settings are the same." in nothing.text
    assert "no run has a rollout" in nothing.text


def test_what_is_no_comparison_is_refused(runs: list[ComparedRun], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at least 2"):
        write_comparison(runs[:1], tmp_path / "out")
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match="not part of a report"):
        write_comparison(runs, tmp_path)
