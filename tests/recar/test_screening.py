"""screening.csv and the contact sheets: what they show, keep and refuse, and who uses them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recast.cli.main import main
from recast.core.errors import InputError
from recast.core.files import read_json, write_json
from recast.recar import VehicleSet, read_set, set_statistics
from recast.recar.screening import (
    read_decisions,
    screened_vehicles,
    swatch,
    write_overview,
    write_screening,
)
from recast.recar.target_cache import TargetCache
from recast.recar.targets import screened_targets
from support.target_caches import write_cache
from support.tiny_stage import tiny_config
from support.trellis_folder import write_golden_model
from support.vehicle_photographs import write_photos
from support.vehicle_sets import tree, write_set


def screen(cars: VehicleSet) -> list[dict[str, str]]:
    write_screening(cars.folder, cars.identities, screened_vehicles(cars))
    return rows(cars.folder)


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "screening.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def write_rows(folder: Path, values: list[dict[str, str]], delimiter: str = ",") -> None:
    with (folder / "screening.csv").open("w", newline="", encoding="utf-8-sig") as stream:
        writer = csv.DictWriter(stream, list(values[0]), delimiter=delimiter)
        writer.writeheader()
        writer.writerows(values)


def test_a_row_a_vehicle_with_its_figures(tmp_path: Path) -> None:
    cars = write_set(tmp_path / "set", 3)
    write_json(cars.folder / "ingest.json", {"skipped": [], "doubts": {"car-1": ["a hole", "dim"]}})
    found = screen(cars)
    assert [(row["number"], row["id"]) for row in found] == [
        ("1", "car-0"),
        ("2", "car-1"),
        ("3", "car-2"),
    ]
    assert [row["verdict"] for row in found] == ["ok", "a hole; dim", "ok"]
    assert found[1]["length_m"] == "4.6" and found[1]["split"] == "held-out"
    assert found[0]["covered_percent"] == f"{100 * 16 * 33 / (48 * 32):.1f}"
    assert found[0]["keep"] == found[0]["note"] == ""
    assert read_set(cars.folder).identities.keys() == cars.identities.keys()


def test_what_the_person_wrote_stays(tmp_path: Path) -> None:
    """Also from a spreadsheet that separates by semicolons, writes a mark and adds a column."""
    cars = write_set(tmp_path / "set", 3)
    before = screen(cars)
    mine = {"keep": "No ", "note": "rust, dents", "by": "Ann"}
    write_rows(cars.folder, [before[0] | {"by": ""}, before[2] | mine], ";")
    after = screen(read_set(cars.folder))
    assert [after[2][name] for name in mine] == ["no", "rust, dents", "Ann"]
    assert read_decisions(cars.folder, cars.identities) == {"car-2": "no"}
    assert set_statistics(cars).left_out == set_statistics(cars).decided == 1
    assert screen(cars) == after


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("id,note\ncar-0,x\n", "line 1: keep: is not a column"),
        ("name,keep\ncar-0,no\n", "line 1: id: is not a column"),
        ("id,keep\ncar-0,no\ncar-9,no\n", "line 3: id: 'car-9' is not in set"),
        ("id,keep\ncar-0,no\ncar-0,yes\n", "line 3: id: car-0 has two rows"),
        ("id,keep\ncar-0,maybe\n", "line 2: keep: is 'maybe'"),
        ("id,keep\ncar-0,no,a,b\n", "line 2: more cells than columns"),
        ("id,keep\n,no\n", "line 2: id: '' is not in set"),
        ("", "line 1: id: is not a column"),
    ],
)
def test_a_bad_table_is_one_line(
    tmp_path: Path, text: str, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    cars = write_set(tmp_path / "set", 3)
    (cars.folder / "screening.csv").write_text(text)
    before = tree(cars.folder)
    for command in ("screen", "stats"):
        assert main(["recar", command, str(cars.folder)]) == 2
        said = capsys.readouterr().err
        assert f"screening.csv: {line}" in said and said.count("\n") == 1 and "; " in said
    assert tree(cars.folder) == before


def test_sheets_are_full_numbered_and_never_stale(tmp_path: Path) -> None:
    cars = write_set(tmp_path / "set", 3)
    (cars.folder / "screening-0009.png").write_bytes(b"of a larger set")
    made = write_screening(cars.folder, cars.identities, screened_vehicles(cars))
    assert (made.sheets, made.vehicles, made.doubted, made.left_out) == (1, 3, 3, 0)
    assert [path.name for path in cars.folder.glob("*.png")] == ["screening-0001.png"]
    with Image.open(cars.folder / "screening-0001.png") as image:
        sheet = np.array(image)
    assert sheet.shape[2] == 3 and sheet.shape[0] < 400
    # The three cells show the rectangles: red, and greener from view to view.
    assert np.count_nonzero((sheet == (200, 40, 10)).all(axis=-1)) > 100

    many = write_set(tmp_path / "many", 25)
    made = write_screening(many.folder, many.identities, screened_vehicles(many))
    assert made.sheets == len(list(many.folder.glob("screening-*.png"))) == 2


def test_targets_are_screened_by_their_contact_sheets(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cache = write_cache(tmp_path / "cache", (0.9, 0.8, 0.2, None))
    path = cache.folder / "records" / "car-0.json"
    write_json(path, read_json(path) | {"score_flipped": 0.95})
    assert main(["recar", "screen", str(cache.folder)]) == 0
    assert "3 vehicles, 2 to look at, 0 decided" in capsys.readouterr().out
    found = rows(cache.folder)
    assert [row["verdict"] for row in found] == [
        "agrees better with front and rear exchanged",
        "ok",
        "score below the threshold 0.5",
    ]
    assert found[2]["score"] == "0.2" and int(found[0]["voxels"]) > 0
    found[0]["keep"] = "no"
    write_rows(cache.folder, found)
    assert TargetCache.open(cache.folder).ids() == ("car-1",)
    cache.preview_path("car-1").write_bytes(b"GIF")
    with pytest.raises(InputError, match=r"car-1\.png"):
        list(screened_targets(cache))


def test_the_overview_shows_vehicles_and_shares(tmp_path: Path) -> None:
    cars = write_set(tmp_path / "set", 3)
    write_overview(cars, set_statistics(cars), tmp_path / "sheet.png")
    with Image.open(tmp_path / "sheet.png") as image:
        sheet = np.array(image)

    def length(name: str) -> int:
        return np.count_nonzero((sheet[:, 400:] == swatch(name)).all(axis=-1).any(axis=0))

    assert length("white") == pytest.approx(2 * length("red"), abs=3) and length("red") > 100
    assert swatch("rosybrown") == (188, 143, 143) and swatch("mud") is None


def test_from_photographs_to_a_model_without_the_vehicles_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The whole way: ingest, screen, edit the table, stats, targets, train."""
    photos = write_photos(tmp_path / "photos", 4, split="train")
    cars, cache, model = tmp_path / "set", tmp_path / "cache", write_golden_model(tmp_path / "m")

    def run(*args: object) -> str:
        assert main(["recar", *map(str, args)]) == 0
        return capsys.readouterr().out

    size = ("--views", 4, "--width", 60, "--height", 40)
    run("ingest", photos, "--out", cars, "--licence", "CC0-1.0", "--remover", "none", *size)
    assert "1 contact sheets: 4 vehicles, 0 to look at" in run("screen", cars)
    found = rows(cars)
    assert {row["verdict"] for row in found} == {"ok"}
    found[1]["keep"], found[2]["keep"] = "no", "yes"
    write_rows(cars, found)
    assert "4 vehicles, 0 to look at, 2 decided, 1 left out" in run("screen", cars)
    assert "2 decided, 1 left out of training" in run("stats", cars)
    run("targets", cars, "--model", model, "--out", cache, "--steps", 4, "--max-voxels", 4096,
        "--filter", "none")  # fmt: skip
    stage = tiny_config(structure={"steps": 2}, latent=None, probe=0).model_dump(mode="json")
    write_json(tmp_path / "stage.json", stage)
    train = ("train", "--model", model, "--targets", cache, "--set", cars, "--device", "cpu",
             "--config", tmp_path / "stage.json")  # fmt: skip
    assert "2 of the 3 training targets are not screened" in run(*train, "--out", tmp_path / "out")
    record = read_json(tmp_path / "out" / "training.json")
    assert (record["inputs"]["train"], record["unscreened"]) == (3, 2)

    # The same number of vehicles, but others: not the same training.
    found[1]["keep"], found[0]["keep"] = "", "no"
    write_rows(cars, found)
    assert main(["recar", *map(str, train), "--out", str(tmp_path / "out")]) == 2
    assert "inputs.pictures_sha256" in capsys.readouterr().err
