"""`recast eval rollouts`: scores of stored rollouts, in a file, a table and as rows."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from recast.cli.main import main
from recast.core.errors import InputError
from recast.logs import DrivingLog, map_of, read_log
from recast.runs.artefacts import rollout_name
from recast.runs.config import RunConfig
from recast.runs.rollouts import write_failure
from recast.runs.run_folder import RunFolder
from recast.simulation import Rollout, RolloutFailure, ego_centre, save_rollout
from recast_bridges.scores.stored import SCORES, score_rollout, score_rows, score_run
from support.made_up_rollouts import make_rollout

CONFIG = RunConfig(track="0", motions=("cut-in-a",), planners=("made-up",))


def replayed(log: DrivingLog, arm: str, ahead: float) -> Rollout:
    """The ego drives as logged; the actor stands on its way, some metres of the route ahead."""
    xy = log.world_from_rig.poses[:, :2, 3]
    step = np.gradient(xy, axis=0)
    ego = np.zeros((len(xy), 11))
    ego[:, :2], ego[:, 2] = xy, np.arctan2(step[:, 1], step[:, 0])
    ego[:, 3] = np.hypot(*step.T) / 0.1
    place = ego_centre(ego[:1, :3], ahead)[0]
    actor = np.tile([*place, 0.0], (len(xy), 1))
    return make_rollout(ego, actor, arm=arm, route=xy, log_ego=ego[:, :4], planner="made-up")


@pytest.fixture
def run(tiny_log_folder: Path, tmp_path: Path) -> Path:
    """A run of three arms: one is clear of the actor, one meets it, one failed."""
    log = read_log(tiny_log_folder)
    folder = RunFolder.create_or_resume(
        tmp_path / "run",
        CONFIG.resolved(),
        tiny_log_folder,
        "hash",
        str(tmp_path / "store"),
    )
    store, used = folder.store(), {}
    made = {"clear": replayed(log, "clear", 500.0), "met": replayed(log, "met", 9.0)}
    failure = RolloutFailure("x", "lost", "0", "cut-in", "b", "made-up", "E", "why")
    writers = {
        arm: partial(lambda rollout, out: save_rollout(rollout, out / "states"), rollout)
        for arm, rollout in made.items()
    }
    for arm, write in {**writers, "lost": partial(write_failure, failure)}.items():
        use = rollout_name("cut-in-a", "made-up", arm)
        used[use] = store.make("rollouts", {"arm": arm}, write, name=use)
    folder.refer(store, used, whole=True)
    return folder.path


def test_every_rollout_that_did_not_fail_is_scored(run: Path) -> None:
    told: list[tuple[int, int]] = []
    found = {one.arm: one for one in score_run(run, lambda *done: told.append(done))}
    assert told[-1] == (3, 3)
    assert set(found) == {"clear", "met"}
    clear, met = found["clear"].values, found["met"].values
    assert (clear["alpasim"].value, clear["neuroncap"].value) == (1.0, 5.0)
    assert (met["alpasim"].value, met["neuroncap_code"].value) == (0.0, pytest.approx(0.0, abs=0.5))
    assert clear["epdms_plans"].value is not None and met["epdms_plans"].value == 0.0
    assert set(found["met"].details["epdms_plans"]["means"]) >= {"no_collision", "lane_keeping"}


def test_means_count_only_what_has_a_value(tiny_log: DrivingLog) -> None:
    rollout, hd_map = replayed(tiny_log, "clear", 500.0), map_of(tiny_log)
    whole = score_rollout(rollout, hd_map)
    laneless = score_rollout(rollout, replace(hd_map, lanes={}, drivable_area=()))
    assert laneless.values["alpasim"].reason == "no drivable area in the map"
    [row] = score_rows([whole, laneless])
    assert (row.rollouts, row.counts["alpasim"], row.counts["neuroncap"]) == (2, 1, 2)
    assert row.means["alpasim"] == 100.0
    [none] = score_rows([laneless])
    assert none.means["epdms_plans"] is None


def test_the_command_prints_a_table_and_writes_a_file(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "scores.json"
    assert main(["eval", "rollouts", str(run), "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert all(word in shown for word in ("clear", "met", "AlpaSim", "5.00"))
    written = json.loads(out.read_text())
    assert written["version"] == 1
    assert {one["arm"] for one in written["rollouts"]} == {"clear", "met"}
    assert all(set(one["scores"]) == set(SCORES) for one in written["rollouts"])

    assert main(["eval", "rollouts", str(run), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["arm"] for row in rows if row["table"] == "arms"] == ["clear", "met"]
    [met] = [row for row in rows if row["table"] == "rollouts" and row["arm"] == "met"]
    assert met["alpasim_percent"] == 0.0
    assert met["alpasim_reason"].startswith("collision at fault")


def test_a_run_without_rollouts_is_refused(tiny_log_folder: Path, tmp_path: Path) -> None:
    RunFolder.create_or_resume(
        tmp_path / "run",
        CONFIG.resolved(),
        tiny_log_folder,
        "hash",
        str(tmp_path / "store"),
    )
    with pytest.raises(InputError, match="do not exist yet"):
        score_run(tmp_path / "run")
