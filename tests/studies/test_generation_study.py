"""`recast eval generation`: from a set and models to tables, differences and sheets."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from recast.cli.main import main
from recast.core.errors import InputError
from recast.metrics.actor_scores import read_cases
from recast.recar.perturb import PerturbationConfig
from recast.studies.generation import cells as generation_cells
from recast.studies.generation.cells import CellMaker, perturbed_input
from recast.studies.generation.rows import StudyModel, parse_models
from recast.studies.generation.study import StudySettings, run_study
from support.studies import write_vehicle_set
from support.trellis_folder import write_golden_model
from support.vehicle_sets import tree

FAR, NEAR = "support.studies:far", "support.studies:near"
BOTH = {"far": FAR, "near": NEAR}


@pytest.fixture(scope="module")
def vehicles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_vehicle_set(tmp_path_factory.mktemp("study") / "set")


def settings(folder: Path, models: dict[str, str] | None = None, **changes: Any) -> StudySettings:
    """Quick ones: placed without a search, few samples."""
    fields: dict[str, Any] = {"placement": "canonical", "samples": 200}
    named = {name: StudyModel(what) for name, what in (models or BOTH).items()}
    return StudySettings(named, folder, **(fields | changes))


def results(out: Path) -> dict[str, bytes]:
    """All files but the timings."""
    return {name: data for name, data in tree(out).items() if name != "timings.json"}


def test_better_models_are_told_from_worse(
    vehicles: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    args = ["eval", "generation", "--model", f"far={FAR}", "--model", f"near={NEAR}"]
    args += ["--set", str(vehicles), "--out", str(out), "--perturbed", "default"]
    assert main([*args, "--samples", "300", "--placement", "canonical"]) == 0
    told = capsys.readouterr().out
    assert "Perturbed inputs: 3 vehicles, 12 views" in told and "mask IoU" in told
    metrics = json.loads((out / "metrics.json").read_text())
    assert [block["condition"] for block in metrics["blocks"]] == ["clean", "perturbed"]
    for block in metrics["blocks"]:
        assert block["identities"] == ["car-1", "car-2", "car-3"]
        far, near = (row["scores"] for row in block["rows"])
        assert near["psnr"] > far["psnr"] + 2 and near["toy"] < far["toy"]
        assert near["fd_toy"] < far["fd_toy"] and near["mask_iou"] > far["mask_iou"]
        assert all(one["better"] == "near" for one in block["differences"])
        assert all(one["low"] <= one["mean"] <= one["high"] for one in block["differences"])
    assert metrics["placement"] == "canonical" and metrics["perturbations"]["rho_clean"] == 0.2
    text = (out / "study.md").read_text()
    assert "| near | 3 | **" in text and "forward axis" in text
    for condition in ("clean", "perturbed"):
        page = cv2.imread(str(out / f"sheet_{condition}_00.png"))
        assert page.shape[0] > 3 * 92 and page.shape[1] > 3 * 4 * 136
    assert json.loads((out / "study.json").read_text())["complete"] is True


@pytest.mark.whole
def test_any_number_of_workers_writes_the_same(vehicles: Path, tmp_path: Path) -> None:
    wanted = settings(vehicles, perturbed=PerturbationConfig(), limit=2)
    told: list[tuple[int, int]] = []
    run_study(wanted, tmp_path / "one", workers=1)
    run_study(wanted, tmp_path / "two", workers=2, progress=lambda *at: told.append(at))
    assert results(tmp_path / "one") == results(tmp_path / "two")
    assert told == [(done, 10) for done in range(11)]


class KilledError(Exception):
    pass


def test_what_was_made_stays(
    vehicles: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed after four vehicles; then a model is added, a vehicle too, and the seed changed."""
    made: list[str] = []
    original = CellMaker.__call__

    def counted(self: CellMaker, job: Any) -> dict[str, float]:
        if len(made) == limit:
            raise KilledError
        made.append(job.folder.relative_to(tmp_path).as_posix())
        return original(self, job)

    monkeypatch.setattr(generation_cells.CellMaker, "__call__", counted)
    out, limit = tmp_path / "out", 4
    two = settings(vehicles, {"far": FAR}, limit=2, perturbed=PerturbationConfig())
    with pytest.raises(KilledError):
        run_study(two, out)
    assert json.loads((out / "study.json").read_text())["complete"] is False
    assert len(json.loads((out / "timings.json").read_text())) == 4
    limit = 1000
    run_study(two, out)
    assert len(made) == len(set(made)) == 6  # nothing twice
    whole = results(out)
    run_study(two, tmp_path / "anew")
    assert results(tmp_path / "anew") == whole

    made.clear()
    run_study(settings(vehicles, limit=3, perturbed=PerturbationConfig()), out)
    assert len(made) == 15 - 6 and "out/cells/clean/far/car-1" not in made
    made.clear()
    # the photographs' cell knows the perturbations that it shows, not how models are placed
    other = settings(vehicles, {"far": FAR}, placement="views", limit=1)
    run_study(replace(other, perturbed=PerturbationConfig()), out)
    assert made == ["out/cells/clean/far/car-1", "out/cells/perturbed/far/car-1"]
    run_study(other, out)
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["placement"] == "views" and metrics["blocks"][0]["differences"] == []
    assert not list(out.glob("sheet_perturbed*"))


def test_a_changed_model_folder_is_made_anew(vehicles: Path, tmp_path: Path) -> None:
    model = write_golden_model(tmp_path / "tiny-model")
    wanted = settings(vehicles, {"golden": str(model)}, limit=1)
    (block,) = run_study(wanted, tmp_path / "out")
    cell = tmp_path / "out" / "cells" / "clean" / "golden" / "car-1" / "cell.json"
    record = json.loads(cell.read_text())
    assert record["facts"]["details"]["model"] == "tiny-model"
    assert block.rows[0].scores["psnr"] > 5
    pipeline = json.loads((model / "pipeline.json").read_text())
    pipeline["args"]["slat_sampler"]["params"]["steps"] = 1
    (model / "pipeline.json").write_text(json.dumps(pipeline))
    run_study(wanted, tmp_path / "out")
    again = json.loads(cell.read_text())
    assert again["key"] != record["key"] and again["scores"] != record["scores"]
    (weights, *_) = sorted((model / "ckpts").glob("*.safetensors"))
    weights.unlink()
    with pytest.raises(InputError, match="is not in the folder"):
        run_study(wanted, tmp_path / "out")


def test_all_models_get_the_same_perturbed_picture(vehicles: Path, tmp_path: Path) -> None:
    config = PerturbationConfig(rho_clean=1.0)
    cases = read_cases(vehicles)
    for case in cases:
        rgba, applied = perturbed_input(case, 0, config)
        again, _ = perturbed_input(case, 0, config)
        np.testing.assert_array_equal(rgba, again)
        assert applied and (rgba != case.inputs[0].load()).any()  # never clean
    first, second = (perturbed_input(cases[0], seed, config)[0] for seed in (0, 1))
    assert (first != second).any()
    out = tmp_path / "out"
    run_study(settings(vehicles, limit=1, perturbed=config), out)
    facts = json.loads((out / "truth" / "car-1" / "cell.json").read_text())["facts"]
    wanted = perturbed_input(cases[0], 0, config)[1]
    assert [one["name"] for one in facts["perturbations"]] == [one["name"] for one in wanted]


def test_failures_are_recorded_and_hopeless_models_named(vehicles: Path, tmp_path: Path) -> None:
    models = {"far": FAR, "failing": "support.studies:failing"}
    (block,) = run_study(settings(vehicles, models), tmp_path / "out")
    assert block.identities == ("car-1", "car-3")
    assert [row.made for row in block.rows] == [3, 2]
    assert "car-2: structure: is empty" in (tmp_path / "out" / "study.md").read_text()
    with pytest.raises(InputError, match="hopeless: vehicles: none could be made; car-1"):
        run_study(
            settings(vehicles, {"hopeless": "support.studies:hopeless"}, limit=1),
            tmp_path / "other",
        )


def test_real_crops_and_the_template(tmp_path: Path) -> None:
    from support.crops import write_crops

    folder = write_crops(tmp_path / "crops")
    models = {"template": "support.studies:coarse_template"}
    (block,) = run_study(settings(folder, models, placement="views"), tmp_path / "out")
    assert block.views == 2
    assert block.rows[0].scores["mask_iou"] > 0.75


def test_bad_input_is_one_line(
    vehicles: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"

    def refused(*models: str, **options: object) -> str:
        args = ["eval", "generation", "--set", str(vehicles), "--out", str(out)]
        for model in models:
            args += ["--model", model]
        for name, value in options.items():
            args += [f"--{name}", str(value)]
        assert main(args) == 2
        line = capsys.readouterr().err
        assert line.startswith("recast: ") and line.count("\n") == 1
        return line

    assert "is not of the form NAME=WHAT" in refused("template")
    assert "is not of the form NAME=WHAT" in refused("../up=template")
    assert "far: is given twice" in refused(f"far={FAR}", f"far={NEAR}")
    assert "diorama: is not known" in refused("a=diorama")
    assert "pipeline.json" in refused(f"a={vehicles}")
    assert "is missing" in refused("a=nowhere.ply")
    assert "--workers: value: is 0" in refused(f"far={FAR}", workers=0)
    assert "--samples: value: is 0" in refused(f"far={FAR}", samples=0)
    assert "nowhere.json: file: is missing" in refused(f"far={FAR}", perturbed="nowhere.json")
    assert not out.exists()
    assert "pth: does not exist" in refused(f"far={FAR}", **{"lpips-weights": "nowhere.pth"})
    out.mkdir()
    (out / "thesis.tex").touch()
    assert "contains other files than those of a study" in refused(f"far={FAR}")
    shutil.rmtree(out)
    assert "none is given" in refused()
    assert parse_models(()) == {}
