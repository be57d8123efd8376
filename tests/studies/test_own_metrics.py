"""A metric of a user's own: in files, tables and reports, and as the objective of a search."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import recast
from recast.cli.main import main
from recast.core.errors import InputError
from recast.logs import write_log
from recast.metrics import BaseMetric, Metric, own_metrics, rollout_metrics
from support.made_up_rollouts import make_rollout, street
from support.own_parts import LeastGap
from support.synthetic_drives import drive

NAME = "support.own_parts:LeastGap"


class Given(BaseMetric):
    """Returns what it was made with, or calls it."""

    def __init__(self, value: Any, name: Any = "given") -> None:
        self.value, self.name = value, name

    def score(self, rollout: Any, hd_map: Any) -> Any:
        return self.value(rollout, hd_map) if callable(self.value) else self.value


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2.0), np.int64(2), Metric(np.float64(2.0))])
def test_numbers_and_metrics_are_values(value: Any) -> None:
    found = recast.score(make_rollout(), street(), [Given(value)]).values["given"]
    assert found.value == 2.0 and type(found.value) is float


def test_it_stands_beside_the_others_and_may_have_no_value() -> None:
    metrics = recast.score(make_rollout(), street(), [Given(None), NAME])
    assert list(metrics.values)[-2:] == ["given", "least_gap_m"]
    assert metrics.to_json()["metrics"]["given"] == {"value": None, "valid": False, "reason": None}
    assert "least gap m" in str(metrics) and "<th>least gap m</th>" in metrics._repr_html_()
    first = metrics.over(1).values["least_gap_m"]
    assert first.value > metrics.values["least_gap_m"].value and first.reason == "at step 1"


def write(rollout: Any, hd_map: Any) -> None:
    rollout.ego[:] = 0.0


def leave(rollout: Any, hd_map: Any) -> None:
    raise SystemExit(3)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (float("nan"), "returns nan; return a finite number"),
        (Metric(float("inf")), "returns inf"),
        (True, "returns True"),
        ("2", "returns 2; return a finite number"),
        ([1.0], r"returns \[1.0\]"),
        (lambda *_: 1 / 0, r"raises ZeroDivisionError: .*, test_own_metrics.py line"),
        (write, "writes into a read-only object"),
        (leave, "ends the program"),
    ],
)
def test_bad_values_and_faults_are_one_line(value: Any, said: str) -> None:
    with pytest.raises(InputError, match=f"metric given: rollout made-up: {said}"):
        rollout_metrics(make_rollout(), street(), [Given(value)])


@pytest.mark.parametrize(
    ("metrics", "said"),
    [
        ([Given(1, "nc")], "metric: nc: is the name of another metric"),
        ([NAME, LeastGap()], "metric: least_gap_m: is the name of another metric"),
        ([Given(1, "Gap m")], "metric: name: is 'Gap m'; use lower-case"),
        ([Given(1, 3)], "metric: name: is 3"),
        (["support.own_parts:Box"], "which lacks score"),
        (["support.nowhere:Metric"], "cannot be imported"),
        ([LeastGap], "is the class LeastGap"),
    ],
)
def test_what_is_not_a_metric_is_refused(metrics: list[Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        own_metrics(metrics)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A straight drive without sensors."""
    out = tmp_path_factory.mktemp("drive") / "log"
    write_log(drive(10.0, 15.0), out)
    return out


def test_a_grid_and_the_reports_of_its_runs_show_it(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["bench", "closed-loop", "--scenes", f"{log}:7", "--out", str(tmp_path / "grid")]
    words += ["--planner", "idm-follower", "--motion", "cut-in-a", "--steps", "20"]
    assert main([*words, "--metric", "least_gap"]) == 2
    assert main([*words, "--metric", NAME]) == 0
    shown = capsys.readouterr().out
    assert "own metrics of" in shown
    assert all(len(line) <= 80 for line in shown.splitlines())
    results = json.loads((tmp_path / "grid" / "results.json").read_text())
    means = [line["means"]["least_gap_m"] for line in results["table"]]
    assert means[0] == means[1] > 0 and results["units"]["least_gap_m"] == ""
    [difference] = [one for one in results["differences"] if one["metric"] == "least_gap_m"]
    assert difference["sampled"]["point"] == 0.0
    [path] = (tmp_path / "grid").glob("scenes/*/metrics.json")
    scored = json.loads(path.read_text())["rollouts"][0]["metrics"]["least_gap_m"]
    assert scored["value"] == pytest.approx(means[0]) and scored["reason"].startswith("at step")
    page = recast.write_report(path.parent, tmp_path / "report").read_text()
    assert page.count("least gap m</abbr>") >= 2 and f"{means[0]:.2f}" in page
    assert main([*words, "--metric", NAME, "--json"]) == 0  # resumed
    rows = json.loads(capsys.readouterr().out)
    assert rows[0]["least_gap_m"] == pytest.approx(means[0])


def test_it_is_the_objective_of_a_search(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["search", f"{log}:7", "--out", str(tmp_path / "study"), "--steps", "20"]
    words += ["--design", "grid", "--trials", "3", "--arm", "native", "--over", "gap=4:40"]
    words += ["--planner", "idm-follower"]
    assert main([*words, "--objective", "least_gap_m<20"]) == 2
    assert "--objective: least_gap_m<20: is not known" in capsys.readouterr().err
    words += ["--metric", NAME]
    assert main([*words, "--objective", "least_gap_m<20"]) == 0
    trials = pq.read_table(tmp_path / "study" / "trials.parquet").to_pylist()
    for one in trials:
        assert one["margin"] == pytest.approx(one["metric_least_gap_m"] - 20)
    assert {one["margin"] < 0 for one in trials} == {True, False}
