"""`--json`: one list of flat rows on standard output, and nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recast.cli.main import main
from recast.cli.shared import print_json, with_unit
from recast.core import Store, files
from recast.logs import DrivingLog
from recast.metrics import COLUMNS
from recast.runs.scores import METRICS_VERSION
from support.trellis_folder import write_golden_model
from support.vehicle_pictures import write_vehicles

KEY = re.compile(r"[a-z][a-z0-9_]*")
Capture = pytest.CaptureFixture[str]


def rows_of(capsys: Capture, *words: str | Path) -> dict[str, list[dict[str, Any]]]:
    """The rows of a command by table; standard output holds one JSON list and nothing else."""
    capsys.readouterr()
    assert main([*map(str, words), "--json"]) == 0
    out = capsys.readouterr().out
    assert "NaN" not in out and "Infinity" not in out
    tables: dict[str, list[dict[str, Any]]] = {}
    for row in json.loads(out):
        assert isinstance(row, dict)
        for key, value in row.items():
            assert KEY.fullmatch(key), key
            flat = value if isinstance(value, list) else [value]
            assert all(one is None or isinstance(one, str | int | float) for one in flat), key
        tables.setdefault(row.pop("table"), []).append(row)
    return tables


def test_values_are_plain_and_finite(capsys: Capture) -> None:
    row = {
        "count": np.int64(3),
        "yes": np.bool_(True),
        "far_m": float("inf"),
        "mean_m": np.float32("nan"),
        "path": Path("a"),
        "names": ("\udcff", np.float64(0.5)),
    }
    print_json({"table one": [row]})
    out = capsys.readouterr().out
    assert out.isascii()
    [read] = json.loads(out)
    assert read == {
        "table": "table one",
        "count": 3,
        "yes": True,
        "far_m": None,
        "mean_m": None,
        "path": "a",
        "names": ["\udcff", 0.5],
    }
    assert [with_unit("x", unit) for unit in ("%", "dB", "m/s", "s", "")] == [
        "x_percent",
        "x_db",
        "x_mps",
        "x_s",
        "x",
    ]


def test_doctor_and_weights(capsys: Capture) -> None:
    [python] = [r for r in rows_of(capsys, "doctor")["parts"] if r["part"] == "python"]
    assert python["present"] is None and "3." in python["detail"]
    [vgg] = [r for r in rows_of(capsys, "weights", "list")["weights"] if r["name"] == "vgg16"]
    assert vgg["options"] == ["--lpips-weights"] and vgg["download_gb"] > 0


def test_store(tmp_path: Path, capsys: Capture) -> None:
    store = Store(tmp_path / "store")
    artefact = store.make(
        "scenes", {"seed": 7}, lambda to: (to / "f").write_bytes(b"x" * 2000), name="a"
    )
    (tmp_path / "run").mkdir()
    store.refer(tmp_path / "run", (artefact.reference,))
    [row] = rows_of(capsys, "store", "list", store.root)["artefacts"]
    assert (row["kind"], row["key"], row["runs"]) == ("scenes", artefact.record.key, 1)
    assert row["size_bytes"] == 2000


def test_scenarios(tiny_log_folder: Path, tmp_path: Path, capsys: Capture) -> None:
    [row] = rows_of(capsys, "scenario", "list", "cut-in-a")["scenarios"]
    assert row["motion"] == "cut-in" and row["gap_m"] > 0 and row["delay_s"] >= 0
    assert 0 < row["target_speed_of_v_r"] < 5
    shown = rows_of(
        capsys,
        "scenario",
        "show",
        tiny_log_folder,
        "--motion",
        "advancing-a",
        "--motion",
        "oncoming-a",
        "--track",
        "0",
        "--out",
        tmp_path / "s.png",
        "--steps",
        "5",
    )["scenarios"]
    assert [row["scenario"] for row in shown] == ["advancing-a", "oncoming-a"]
    assert any(row["refused"] is None and row["asked_s"] == 0.5 for row in shown)
    assert (tmp_path / "s.png").is_file()


def test_models_and_sets(tmp_path: Path, capsys: Capture) -> None:
    checks = rows_of(capsys, "trellis", "verify", write_golden_model(tmp_path / "model"))["models"]
    assert len(checks) == 7 and all(row["problem"] is None for row in checks)
    write_vehicles(tmp_path / "set", 3)
    tables = rows_of(capsys, "recar", "stats", tmp_path / "set")
    assert tables["set"][0]["identities"] == 3 and tables["set"][0]["size_bytes"] > 100
    assert sum(row["identities"] for row in tables["kinds"]) == 3


def test_targets(tmp_path: Path, capsys: Capture) -> None:
    from recast.cli.rows.results import target_rows
    from recast.recar.targets import target_statistics
    from support.target_caches import write_cache

    cache = write_cache(tmp_path / "cache")
    print_json(target_rows(cache, target_statistics(cache)))
    targets, failure = json.loads(capsys.readouterr().out)
    assert (targets["done"], targets["failed"]) == (4, 1)
    assert failure["reason"] == "the sampled structure is empty" and failure["vehicles"] == 1


def _metrics(out: Path, means: Mapping[str, float | None]) -> None:
    row = {
        "planner": "p",
        "arm": "native",
        "asked": 2,
        "rollouts": 1,
        "failed": 1,
        "cut": 0,
        "plans": 4,
        "means": means,
        "counts": dict.fromkeys(means, 1),
    }
    failure = {
        "motion": "cut-in",
        "setting": "a",
        "arm": "native",
        "planner": "p",
        "name": "cut-in-a",
        "track_id": "0",
        "error": "ValueError",
        "reason": "no road",
    }
    record = {"version": METRICS_VERSION, "table": [row], "rollouts": [], "failures": [failure]}
    files.write_json(out / "metrics.json", record)


@pytest.mark.parametrize("command", ["run", "demo"])
def test_run_and_demo(
    command: str, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    means: dict[str, float | None] = {**dict.fromkeys(COLUMNS, 50.0), "ttc": None}

    def ran(log: Path, out: Path, config: object, console: Any, store: object) -> None:
        console.print("human words")
        _metrics(out, means)

    def demo(out: Path, *_: object) -> None:
        _metrics(out / "run", means)

    monkeypatch.setattr("recast.runs.run.run", ran)
    monkeypatch.setattr("recast.runs.run.demo", demo)
    words = ("demo",) if command == "demo" else ("run", "log", "--track", "0")
    (tmp_path / "run").mkdir()
    tables = rows_of(capsys, *words, "--out", tmp_path)
    [arm], [failure] = tables["arms"], tables["failures"]
    assert arm["nc_percent"] == 50.0 and arm["ttc_s"] is None and arm["asked"] == 2
    assert failure == {"rollout": "cut-in-a", "reason": "no road"}


def test_bench(tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    from recast.metrics.scene_level_table import LevelRow, Value
    from recast.studies.closed_loop import summarise
    from recast.studies.grid import GridRow

    def ran(settings: Any, *_: object, **__: object) -> Any:
        scores = dict.fromkeys(COLUMNS, 1.0)
        rows = [
            GridRow(
                scene,
                None,
                None,
                "cut-in",
                "a",
                arm,
                "p",
                steps_run=160,
                plan_steps=(0,),
                scores=scores,
            )
            for scene in ("one", "two")
            for arm in ("native", "oracle", "recast+oracle")
        ]
        rows[0] = rows[0].failed("ValueError", "no road")
        return summarise(rows, replace(settings, samples=10))

    monkeypatch.setattr("recast.studies.run_closed_loop", ran)
    arms = [word for arm in ("native", "oracle", "recast+oracle") for word in ("--arm", arm)]
    common = ("--scenes", "urban-straight", "--out", tmp_path, *arms)
    # Motions may be given in one list, or one by one.
    tables = rows_of(
        capsys,
        "bench",
        "closed-loop",
        *common,
        "--motions",
        "cut-in-a",
        "oncoming-a",
        "--motion",
        "stationary-a",
    )
    native = tables["arms"][0]
    assert (native["asked"], native["rollouts"], native["nc_percent"]) == (2, 1, 100.0)
    assert native["ttc_low_s"] == 1.0
    assert {row["unit"] for row in tables["differences"]} == {"s", "%"}
    against = tables["against_the_truth"][0]
    assert (against["same_verdict_percent"], against["noise_floor_percent"]) == (100.0, None)
    street, vehicle = tables["decomposition"]
    assert (street["part"], street["other"], street["pairs"]) == ("street", "recast+oracle", 2)
    assert (vehicle["part"], vehicle["pairs"], vehicle["loss_percent"]) == ("vehicle", 1, 0.0)
    assert tables["failures"][0]["reason"] == "no road"

    lines = [LevelRow("native", 3, {"lpips": Value(0.25, 0.1, float("nan"))})]
    monkeypatch.setattr("recast.studies.scene_level_study.run_scene_level", lambda *_, **__: lines)
    [score] = rows_of(capsys, "bench", "scene-level", *common)["scores"]
    assert (score["score"], score["value"], score["high"]) == ("lpips", 0.25, None)


def test_scene_eval(
    tiny_log: DrivingLog, tiny_log_folder: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    from recast.reconstruction import FrameScore, RegionScore, SceneEvaluation
    from recast.reconstruction.scores import DepthScore

    depth = DepthScore(100, 0.25, 0.1, 0.2, 0.02, 5.0)
    whole = RegionScore(30.0, 0.9)
    frame = FrameScore("front", 0, 0, whole, {"7": 25.0}, whole, depth)
    monkeypatch.setattr(
        "recast.runs.display.evaluate_and_print", lambda *_, **__: SceneEvaluation((frame,))
    )
    tables = rows_of(capsys, "scene", "eval", "scene", "--log", tiny_log_folder)
    assert [row["region"] for row in tables["held_out_images"]] == [
        "whole image",
        "moving objects",
        "box",
        "all boxes",
    ]
    assert tables["held_out_images"][2]["track_id"] == "7"
    assert tables["depth"][0]["missing_percent"] == 25.0
    assert tables["depth"][0]["median_error_m"] == 0.1


def test_vehicles_and_planners(capsys: Capture) -> None:
    from recast.actors.actor import CandidateRecord, CandidateScore
    from recast.cli.rows import results
    from recast.metrics.table import Bootstrap
    from recast.studies.generation.report import StudyBlock, StudyDifference, StudyRow
    from recast.studies.logged_vehicles import TrackResult
    from recast.studies.photographs import PhotographEvaluation, PhotographScores
    from recast_tools.cli.planner import _probe_rows
    from recast_tools.planner_probe import ProbeRow

    score = CandidateScore(
        outline=0.9, colour=None, lidar=1.0, lidar_median=0.02, free=0.1, total=40.0, fits=True
    )
    chosen = CandidateRecord(generator="template", seed=1, label="suv", score=score, chosen=True)
    failed = CandidateRecord(generator="x", seed=2, label="no wheel")
    difference = StudyDifference("b", "a", "psnr", Bootstrap(1.0, 0.5, 1.5, 1.0, 0.1, 0.95))
    block = StudyBlock(
        "clean",
        ("v",),
        2,
        {"a": {"w": "empty"}},
        (StudyRow("a", 1, {"psnr": 20.0, "clip": 80.0}),),
        (difference,),
        {},
    )
    probed = ProbeRow("street", "cut-in-a", {"visible": 1.5}, {"visible": 2.0}, {"visible": 30.0})
    scores = {"psnr": 20.0, "parts": 50.0}
    judged = PhotographScores("t", "g", (), {"w": "empty"}, scores, {}, 2)
    for rows in (
        results.candidate_rows([chosen, failed]),
        results.photograph_rows(PhotographEvaluation(0, (judged,))),
        results.track_rows([TrackResult("7", 3, {"refined": 25.0}, {"refined": 0.8}, {})]),
        results.study_rows([block]),
        _probe_rows([probed, ProbeRow("s", "m", {}, {}, {}, "no road")]),
    ):
        print_json(rows)
    decoder, text, found = json.JSONDecoder(), capsys.readouterr().out, []
    while text:
        rows_read, end = decoder.raw_decode(text)
        found.append(rows_read)
        text = text[end:].lstrip()
    candidates, actor, tracks, study, probe = found
    assert candidates[0]["lidar_median_m"] == 0.02 and candidates[1]["score"] is None
    assert actor[0]["psnr_db"] == 20.0 and actor[0]["parts_percent"] == 50.0
    assert actor[2]["reason"] == "empty"
    assert tracks[0]["model"] == "refined" and tracks[0]["psnr_db"] == 25.0
    assert study[0]["psnr_db"] == 20.0 and study[0]["clip"] == 80.0
    assert study[1]["better"] == "b" and study[2]["vehicle"] == "w"
    assert probe[0]["contact_s"] == 1.5 and probe[1]["problem"] == "no road"


def test_an_error_prints_no_json(tmp_path: Path, capsys: Capture) -> None:
    assert main(["store", "list", str(tmp_path), "--json"]) == 2
    assert capsys.readouterr().out == ""
