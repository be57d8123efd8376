"""`recast bench trust`: a calibration from finished grids, applied to others."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from recast.cli.main import main
from recast.core import Store, files, folder_hash
from recast.core.errors import InputError
from recast.logs import map_of, read_log, write_log
from recast.metrics.trust import packaged_calibration, read_calibration
from recast.runs.arms import Arm
from recast.runs.config import RunConfig
from recast.runs.rollouts import given_views
from recast.runs.run_folder import METRICS_FILE, RunFolder, rollout_name
from recast.runs.scores import RunTrust, read_metrics, write_metrics
from recast.simulation import Rollout, save_rollout
from recast.studies import BenchScene
from recast.studies.scene_run import scene_rows
from recast.studies.trust import judged_rollouts
from recast.studies.verdicts import write_rows
from support.box_world import CAMERA, box_log
from support.made_up_rollouts import make_rollout

CONFIG = RunConfig(
    track="7",
    motions=("cut-in-a", "cut-in-b"),
    planners=("p",),
    arms=(
        Arm.native(),
        Arm.oracle(),
        Arm.native().disturbed("jitter"),
        Arm.native().disturbed("grey"),
        Arm.oracle().disturbed("seed"),
    ),
)
VIEW = {
    "view": "front",
    "camera": "front",
    "source": "front",
    "virtual": False,
    "seen": 1.0,
    "width": 96,
    "height": 64,
}


def rollout(setting: str, arm: str, aside: float) -> Rollout:
    """An ego that moves `aside` metres to its left on its way to the actor, which stands at 3 m."""
    states = np.arange(61)
    ego = np.zeros((61, 11))
    ego[:, 0], ego[:, 3] = 0.5 * states, 5.0
    ego[:, 1] = aside * np.clip(states / 20, 0, 1)
    actor = np.tile([25.0, 3.0, 0.0, 0.0], (61, 1))
    return make_rollout(ego, actor, arm=arm, motion="cut-in", setting=setting)


def keep(one: Rollout, views: list[dict[str, object]], folder: Path) -> None:
    save_rollout(one, folder / "states")
    record = {"planner": one.planner, "device": None, "views": views}
    files.write_json(folder / "planner.json", record)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("box") / "log"
    boxes = box_log()
    images = [np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)] * 7
    front = replace(boxes.cameras["front"], images=images)
    write_log(replace(boxes, cameras={"front": front}), path)
    return path


def make_grid(
    grid: Path,
    log: Path,
    scenes: int = 2,
    views: tuple[object, ...] = (VIEW,),
    oracle: bool = True,
    config: RunConfig = CONFIG,
) -> Path:
    """The native actor is hit in setting a, where the true one is not; in b nothing is.

    Where its images jitter, the native actor is missed in setting a, too.
    """
    store, rows = Store(grid.parent / "store"), []
    for number in range(scenes):
        scene, used = BenchScene(f"street-{number}", log=log, track="7"), {}
        for setting in ("a", "b"):
            for arm in config.arms:
                hits = setting == "a" and not arm.is_truth and arm.noise != "jitter"
                one = rollout(setting, arm.name, 3.0 if hits else -0.1 * number)
                use = rollout_name(f"cut-in-{setting}", "p", arm.name)
                inputs = {"use": use, "grid": str(grid), "scene": number}
                used[use] = store.make(
                    "rollouts", inputs, partial(keep, one, list(views)), name=use
                )
        out = grid / "scenes" / scene.id
        folder = RunFolder.create_or_resume(
            out, config.resolved(), log, folder_hash(log), str(store.root)
        )
        folder.refer(store, used, whole=True)
        opened = read_log(log)
        write_metrics(out / METRICS_FILE, config, used, map_of(opened), RunTrust(opened, "7"))
        metrics = read_metrics(out / METRICS_FILE)
        names = {"p": "constant_velocity"}
        rows += scene_rows(scene, config, "boxes", names, metrics, used, {})
    files.write_json(grid / "bench.json", {"format": "recast-closed-loop", "version": 2})
    write_rows(rows, grid / "rollouts.parquet", "oracle" if oracle else None)
    return grid


@pytest.fixture(scope="module")
def grid(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_grid(tmp_path_factory.mktemp("grids") / "first", log)


def test_verdicts_and_features_come_from_the_grid(grid: Path) -> None:
    found = judged_rollouts(grid)
    of_a = [("native", False, 0.5), ("native:jitter", True, 1.0), ("native:grey", False, 0.5)]
    of_b = [("native", True, 0.0), ("native:jitter", True, 0.0), ("native:grey", True, 0.0)]
    seen = [(one.arm, one.agrees, one.features["noise_flips"]) for one in found]
    assert seen == 2 * [*of_a, *of_b]
    assert [one.scene for one in found] == 6 * ["street-0"] + 6 * ["street-1"]
    metrics = read_metrics(grid / "scenes" / "street-1" / METRICS_FILE)["rollouts"]
    judged = [entry for entry in metrics if not entry["arm"].startswith("oracle")]
    for one, entry in zip(found[6:], judged, strict=True):
        known = {k: v for k, v in entry["trust"]["features"].items() if v is not None}
        assert one.features == known
    assert all(entry["trust"] is None for entry in metrics if entry not in judged)


def test_a_calibration_and_its_diagrams_are_written(
    grid: Path, log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = make_grid(tmp_path / "other", log, scenes=1)
    out = tmp_path / "trust.json"
    command = ["bench", "trust", str(grid), "--out", str(out), "--validate", str(other), "--json"]
    assert main(command) == 0
    calibration = read_calibration(out)
    assert calibration.data.grids == ("first",)
    assert (calibration.data.rollouts, calibration.data.agreeing) == (12, 8)
    model = calibration.model
    right, wrong = (
        np.mean([model.trust(one.features) for one in judged_rollouts(grid) if one.agrees is a])
        for a in (True, False)
    )
    assert right > wrong
    rows = json.loads(capsys.readouterr().out)
    scores = {row["data"]: row for row in rows if row["table"] == "scores"}
    assert (scores["left out"]["scenes"], scores["validation"]["scenes"]) == (2, 1)
    assert scores["left out"]["auc"] == calibration.left_out.auc == 1.0
    bins = [row["count"] for row in rows if row["table"] == "bins" and row["data"] == "validation"]
    assert sum(bins) == 6
    for name in ("trust.svg", "trust-validation.svg"):
        drawn = ElementTree.parse(tmp_path / name).getroot()
        assert drawn.tag.endswith("svg") and "var(" not in (tmp_path / name).read_text()
    again = tmp_path / "again"
    again.mkdir()
    command[4] = str(again / "trust.json")
    assert main(command) == 0
    assert (again / "trust.json").read_bytes() == out.read_bytes()
    assert (again / "trust.svg").read_bytes() == (tmp_path / "trust.svg").read_bytes()


@pytest.mark.parametrize("undisturbed_first", [True, False])
def test_a_rollout_of_two_grids_counts_once(
    grid: Path, log: Path, tmp_path: Path, undisturbed_first: bool
) -> None:
    """With its flips, which only the grid with disturbed arms knows."""
    few = CONFIG.model_copy(update={"arms": CONFIG.arms[:2]})
    undisturbed = make_grid(tmp_path / "undisturbed", log, config=few)
    assert not any("noise_flips" in one.features for one in judged_rollouts(undisturbed))
    out, grids = tmp_path / "trust.json", [str(undisturbed), str(grid)]
    grids = grids if undisturbed_first else grids[::-1]
    assert main(["bench", "trust", *grids, "--out", str(out)]) == 0
    calibration = read_calibration(out)
    assert (calibration.data.rollouts, calibration.data.agreeing) == (12, 8)
    (flips,) = (one for one in calibration.features if one.name == "noise_flips")
    assert flips.known == 12


def test_the_packaged_calibration_is_validated(
    grid: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "trust", "--validate", str(grid)]) == 0
    assert "8 of 12 agree, 2 scenes" in capsys.readouterr().out
    model = packaged_calibration().model
    metrics = read_metrics(grid / "scenes" / "street-0" / METRICS_FILE)["rollouts"]
    features = {k: v for k, v in metrics[0]["trust"]["features"].items() if v is not None}
    assert metrics[0]["trust"]["value"] == model.trust(features)


def test_a_planner_that_looks_at_nothing_is_trusted(log: Path, tmp_path: Path) -> None:
    blind = make_grid(tmp_path / "blind", log, views=())
    assert judged_rollouts(blind) == []
    metrics = read_metrics(blind / "scenes" / "street-0" / METRICS_FILE)["rollouts"]
    assert metrics[0]["trust"]["value"] == 1.0
    assert "uses no images" in metrics[0]["trust"]["words"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "GRIDS: grid: none is given"),
        (["GRID"], "--out: calibration: is missing"),
        (
            ["GRID", "--out", "x.json", "--calibration", "y.json"],
            "--out: calibration: is made from GRIDS",
        ),
        (["--validate", "GRID", "--calibration", "nowhere.json"], "nowhere.json"),
        (["nowhere", "--out", "x.json"], "bench.json"),
        (["BLIND", "--out", "x.json"], "no planner of the grid uses images"),
        (["UNFINISHED", "--out", "x.json"], "the grid is not finished"),
        (["WITHOUT-TRUTH", "--out", "x.json"], "no rollout was compared with the truth"),
        (["ONE", "--out", "x.json"], "at least 2 are needed"),
    ],
)
def test_bad_input_is_one_line(
    words: list[str],
    message: str,
    grid: Path,
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    if "BLIND" in words:
        make_grid(tmp_path / "BLIND", log, views=())
    if "ONE" in words:
        make_grid(tmp_path / "ONE", log, scenes=1)
    if "WITHOUT-TRUTH" in words:
        make_grid(tmp_path / "WITHOUT-TRUTH", log, oracle=False)
    if "UNFINISHED" in words:
        (make_grid(tmp_path / "UNFINISHED", log) / "rollouts.parquet").unlink()
    assert main(["bench", "trust", *(str(grid) if w == "GRID" else w for w in words)]) != 0
    told = capsys.readouterr().err
    assert message in " ".join(told.split()), told
    assert "Traceback" not in told
    assert not (tmp_path / "x.json").exists()


@pytest.mark.parametrize("text", ['{"views": [{"view": "front"}]}', "{}", "[]", "{"])
def test_a_damaged_planner_record_is_one_line(text: str, tmp_path: Path) -> None:
    (tmp_path / "planner.json").write_text(text)
    with pytest.raises(InputError, match=r"planner\.json") as caught:
        given_views(tmp_path)
    assert "\n" not in str(caught.value)
