"""metrics.json: what was cut or failed, and pairs over the steps that both rollouts have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from recast.core import Store, files
from recast.metrics import COLUMNS, rollout_metrics
from recast.metrics.table import over_common_steps
from recast.runs.artefacts import rollout_name
from recast.runs.config import RunConfig
from recast.runs.rollouts import write_failure
from recast.runs.run_folder import METRICS_FILE
from recast.runs.scores import RunTrust, read_metrics, write_metrics
from recast.simulation import Rollout, RolloutFailure, save_rollout
from recast.studies.grid import GridRow
from support.box_world import box_log
from support.made_up_rollouts import make_rollout, street


def rollout(arm: str, setting: str, steps: int, hit: bool) -> Rollout:
    """At 5 m/s; if it hits, it reaches the actor after 3.7 s."""
    made = make_rollout(steps=steps, arm=arm, motion="cut-in", setting=setting)
    actor = made.actor.copy()
    actor[:, :2] = (25.0, 0.0) if hit else (25.0, 10.0)
    cut = None if steps == 160 else f"the log ends {steps / 10} s after the start"
    return replace(made, actor=actor, cut_reason=cut)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """metrics.json of three rollouts and a failure."""
    config = RunConfig(track="7", motions=("cut-in-a", "cut-in-b"), planners=("p",))
    made = [
        rollout("native", "a", 160, True),
        rollout("replaced", "a", 20, True),
        rollout("replaced", "b", 160, False),
    ]
    store, used = Store(tmp_path / "store"), {}

    def keep(setting: str, arm: str, write: Callable[[Path], None]) -> None:
        use = rollout_name(f"cut-in-{setting}", "p", arm)
        used[use] = store.make("rollouts", {"use": use}, write, name=use)

    for one in made:
        keep(one.setting, one.arm, partial(_save, one))
    failure = RolloutFailure("x", "native", "7", "cut-in", "b", "constant_velocity", "E", "why")
    keep("b", "native", partial(write_failure, failure))
    write_metrics(tmp_path / METRICS_FILE, config, used, street(), RunTrust(box_log(), "7"))
    return tmp_path


def _save(one: Rollout, folder: Path) -> None:
    save_rollout(one, folder / "states")
    files.write_json(folder / "planner.json", {"planner": one.planner, "device": None, "views": []})


def test_the_table_counts_what_failed_and_was_cut(run: Path) -> None:
    metrics = read_metrics(run / METRICS_FILE)
    counted = ("asked", "rollouts", "failed", "cut", "plans")
    assert {row["arm"]: [row[name] for name in counted] for row in metrics["table"]} == {
        "native": [2, 1, 1, 0, 32],
        "replaced": [2, 2, 0, 1, 4 + 32],
    }
    assert metrics["table"][1]["means"]["nc"] == 100.0  # as far as it went


def test_differences_are_over_common_plans(run: Path) -> None:
    found = {one["metric"]: one for one in read_metrics(run / METRICS_FILE)["differences"]}
    assert set(found) == set(COLUMNS)
    assert {key: found["nc"][key] for key in ("mean", "pairs", "asked", "plans", "cut")} == {
        "mean": 0.0,
        "pairs": 1,
        "asked": 2,
        "plans": 4,
        "cut": 1,
    }
    assert found["r_c"]["mean"] == 0.0
    assert (found["nc"]["candidate"], found["nc"]["baseline"]) == ("replaced", "native")


def test_a_grid_s_row_has_the_shorter_scores_too(run: Path) -> None:
    entries = read_metrics(run / METRICS_FILE)["rollouts"]
    native, replaced = (
        GridRow("s", None, None, "cut-in", "a", one["arm"], "p").scored(one) for one in entries[:2]
    )
    assert (native.collided, native.plans, list(native.shorter)) == (True, 32, [20])
    one, other = over_common_steps(native, replaced)
    expected = rollout_metrics(rollout("native", "a", 20, True), street()).values
    assert {name: metric.value for name, metric in one.values.items()} == {
        name: metric.value for name, metric in expected.items()
    }
    assert (one.plans, other.plans, one.collided, other.collided) == (4, 4, False, False)
