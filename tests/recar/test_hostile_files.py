"""Names and JSON files from outside: refused in one line, or shown as text."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from recast.cli.recar_sets import Ingest
from recast.core import files
from recast.core.errors import InputError
from recast.recar import read_real_crops, read_set, set_statistics, statistics_table
from recast.recar.ingest import read_doubts
from recast.recar.ingest_table import read_table
from recast.recar.perturb import read_perturbations
from recast.recar.screening import (
    read_decisions,
    screened_vehicles,
    write_overview,
    write_screening,
)
from recast.recar.target_cache import TargetCache
from recast.recar.training_config import read_stage_config, read_training_record
from recast.training.loop import read_log_lines, train
from recast.training.state import STATE_FILE, steps_done
from recast_tools.small_model.asset_synthesis import AssetsRecord, make_assets
from support.crops import write_crops
from support.line_task import SETTINGS, Line
from support.target_caches import write_cache
from support.vehicle_photographs import VIEWS, write_photos
from support.vehicle_sets import tree, write_set

NAMES = [
    "../x",
    "/etc/passwd",
    "a/b",
    "..",
    ".",
    "",
    "a\0b",
    "a\nb",
    "a" * 300,
    "\u202ecod.exe",
    "<script>alert(1)</script>",
    "a\\b",
    "C:x",
    "-rf",
    "é",
    "\x1b[31mred",
    "[bold]x[/nope]",
]
TEXTS = [*NAMES[5:], "$\\frac$", "{0}", "%s", "[/]"]


def outside(tmp_path: Path, inside: Path) -> dict[str, bytes]:
    return {n: d for n, d in tree(tmp_path).items() if not (tmp_path / n).is_relative_to(inside)}


@pytest.mark.parametrize("name", NAMES)
def test_ingest_lists_them_and_writes_nothing_elsewhere(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    photos = write_photos(tmp_path / "photos", 2)
    rows = [{"id": "car-0", "kind": "van"}, {"id": name, "kind": "van", "folder": "car-1"}]
    (photos / "vehicles.csv").unlink()
    files.write_json(photos / "vehicles.json", rows)
    out = tmp_path / "set"
    before = outside(tmp_path, out)
    command = Ingest(photos, out, "CC0-1.0", views=VIEWS, width=60, height=40, remover="none")
    with pytest.raises(InputError):
        command()
    assert not out.exists()
    Ingest(**{**vars(command), "skip_bad": True})()
    assert outside(tmp_path, out) == before
    assert list(read_set(out).identities) == ["car-0"]
    said = capsys.readouterr().out
    assert "\x1b" not in said and "\u202e" not in said and "\0" not in said


@pytest.mark.parametrize("name", NAMES)
def test_a_folder_named_in_the_table_is_below_the_photographs(tmp_path: Path, name: str) -> None:
    photos = write_photos(tmp_path / "photos", 1)
    (photos / "vehicles.csv").unlink()
    files.write_json(photos / "vehicles.json", [{"id": "car-0", "kind": "van", "folder": name}])
    # What it would find there, were it to look.
    (photos / "car-0").rename(tmp_path / "x")
    command = Ingest(photos, tmp_path / "set", "CC0", views=VIEWS, width=60, height=40)
    with pytest.raises(InputError):
        command()
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize("name", NAMES)
def test_sets_caches_and_tables_refuse_them(tmp_path: Path, name: str) -> None:
    folder = write_set(tmp_path / "set").folder
    record = files.read_json(folder / "car-0" / "identity.json")
    files.write_json(folder / "car-0" / "identity.json", record | {"id": name})
    with pytest.raises(InputError, match=r"identity\.json: id: "):
        read_set(folder)

    cache = write_cache(tmp_path / "cache").folder
    one = files.read_json(cache / "records" / "car-0.json")
    files.write_json(cache / "records" / "car-0.json", one | {"id": name})
    with pytest.raises(InputError, match=r"car-0\.json: id: "):
        TargetCache.open(cache)

    with (folder / "screening.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([["id", "keep"], [name, "no"]])
    with pytest.raises(InputError, match=r"screening\.csv: line \d+") as caught:
        read_decisions(folder, ["car-0"])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("model", ["../../x", "/x", "a\0b", "..", "a" * 300])
def test_a_cache_names_its_model_as_a_folder_of_its_own(tmp_path: Path, model: str) -> None:
    cache = write_cache(tmp_path / "cache").folder
    record = files.read_json(cache / "cache.json")
    record["model"]["name"] = model
    files.write_json(cache / "cache.json", record)
    with pytest.raises(InputError) as caught:
        TargetCache.open(cache).target("car-0")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", TEXTS)
def test_texts_for_people_come_out_as_text(tmp_path: Path, text: str) -> None:
    folder = write_set(tmp_path / "set").folder
    words = text or "x"
    shared = files.read_json(folder / "set.json")
    files.write_json(
        folder / "set.json", shared | {"name": words, "source": words, "licence": words}
    )
    path = folder / "car-0" / "identity.json"
    files.write_json(path, files.read_json(path) | {"kind": words, "colour": words})
    found = read_set(folder)
    statistics = set_statistics(found)
    stream = StringIO()
    Console(file=stream, width=400, force_terminal=True, no_color=True).print(
        statistics_table(found, statistics)
    )
    printed = stream.getvalue()
    assert "\x1b[31m" not in printed and "\u202e" not in printed and "\0" not in printed
    if words.isprintable() and words.isascii() and len(words) < 40:
        assert words in printed
    write_overview(found, statistics, tmp_path / "overview.png")
    write_screening(folder, found.identities, screened_vehicles(found))
    assert read_decisions(folder, found.identities) == {}


DAMAGE = {
    "nested": b"[" * 100_000,
    "nested objects": b'{"a":' * 100_000,
    "huge integer": b'{"version": ' + b"9" * 5000 + b"}",
    "huge float": b'{"version": 1e999}',
    "not a number": b'{"version": NaN}',
    "not UTF-8": b'{"format": "\xff"}',
    "cut short": b'{"format": ',
    "empty": b"",
    "a list": b"[1, 2]",
    "null": b"null",
}


def made_set(root: Path) -> Path:
    return write_set(root / "set").folder


def made_cache(root: Path) -> Path:
    return write_cache(root / "cache").folder


def made_crops(root: Path) -> Path:
    return write_crops(root / "crops")


def made_file(root: Path) -> Path:
    (root / "file").mkdir()
    return root / "file"


READERS: list[tuple[Callable[[Path], Path], str, Callable[[Path], object]]] = [
    (made_set, "set.json", read_set),
    (made_set, "car-1/identity.json", read_set),
    (made_set, "ingest.json", read_doubts),
    (made_cache, "cache.json", TargetCache.open),
    (made_cache, "records/car-0.json", TargetCache.open),
    (made_crops, "car-a/input_views/camera.json", read_real_crops),
    (made_file, "vehicles.json", lambda f: read_table(f / "vehicles.json")),
    (made_file, "stage.json", lambda f: read_stage_config(f / "stage.json")),
    (made_file, "perturb.json", lambda f: read_perturbations(f / "perturb.json")),
    (made_file, "training.json", read_training_record),
    (made_file, "assets.json", lambda f: make_assets(f, 1, AssetsRecord())),
    (made_file, "log.jsonl", lambda f: read_log_lines(f / "log.jsonl")),
]


@pytest.mark.parametrize("name", [*DAMAGE, "a folder"])
@pytest.mark.parametrize(("make", "file", "read"), READERS, ids=[r[1] for r in READERS])
def test_damage_is_one_line_that_names_the_file(
    tmp_path: Path,
    make: Callable[[Path], Path],
    file: str,
    read: Callable[[Path], object],
    name: str,
) -> None:
    folder = make(tmp_path)
    path = folder / file
    path.unlink(missing_ok=True)
    if name == "a folder":
        path.mkdir()
    else:
        # What ends without a line break is, in a log, what a kill cut short.
        path.write_bytes(DAMAGE[name] + b"\n" * (path.suffix == ".jsonl"))
    with pytest.raises(InputError) as caught:
        read(folder)
    assert path.name in str(caught.value)
    assert len(str(caught.value)) <= 300 and "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    train(Line(), SETTINGS, folder)
    return folder


@pytest.mark.parametrize("name", DAMAGE)
def test_the_header_of_a_checkpoint(trained: Path, tmp_path: Path, name: str) -> None:
    text = DAMAGE[name].decode("latin-1")
    save_file(load_file(trained / STATE_FILE), tmp_path / STATE_FILE, {"recast-training": text})
    for read in (lambda: steps_done(tmp_path), lambda: train(Line(), SETTINGS, tmp_path)):
        with pytest.raises(InputError, match=r"state\.safetensors: "):
            read()


def changed_header(trained: Path, folder: Path, **changes: object) -> None:
    with safe_open(trained / STATE_FILE, framework="pt") as file:
        header = json.loads(file.metadata()["recast-training"])
    text = json.dumps(header | changes)
    save_file(load_file(trained / STATE_FILE), folder / STATE_FILE, {"recast-training": text})


@pytest.mark.parametrize(
    "change",
    [
        {"step": -1},
        {"step": "many"},
        {"step": 10**400},
        {"clipper": None},
        {"clipper": {}},
        {"clipper": {"norms": ["x"]}},
        {"log": {"sums": 3}},
        {"settings": None},
    ],
)
def test_members_of_the_header(trained: Path, tmp_path: Path, change: dict[str, object]) -> None:
    changed_header(trained, tmp_path, **change)
    with pytest.raises(InputError, match=r"state\.safetensors: "):
        train(Line(), SETTINGS, tmp_path)


@pytest.mark.parametrize(
    "name", ["model/line/0.weight", "optimiser/0/exp_avg", "average/line/0.bias"]
)
def test_tensors_of_a_checkpoint(trained: Path, tmp_path: Path, name: str) -> None:
    with safe_open(trained / STATE_FILE, framework="pt") as file:
        texts = file.metadata()
    good = load_file(trained / STATE_FILE)
    for change in ("nan", "shape", "missing"):
        tensors = dict(good)
        if change == "nan":
            tensors[name] = good[name] * float("nan")
        elif change == "shape":
            tensors[name] = good[name].flatten()[:1].clone()
        else:
            del tensors[name]
        save_file(tensors, tmp_path / STATE_FILE, texts)
        with pytest.raises(InputError, match=r"state\.safetensors: "):
            train(Line(), SETTINGS, tmp_path)


@pytest.mark.parametrize("line", ["[]", '{"step": 3}', '{"step": "x", "seconds": 1}', "{}"])
def test_lines_of_a_log_that_are_none(tmp_path: Path, line: str) -> None:
    path = tmp_path / "log.jsonl"
    good = '{"step": 1, "seconds": 0.5, "loss": 2.0}\n'
    path.write_text(good + line + "\n" + good)
    with pytest.raises(InputError, match=r"log\.jsonl: line 2: "):
        read_log_lines(path)
    path.write_text(good + line)  # cut short: no line break
    assert read_log_lines(path) == [{"step": 1, "seconds": 0.5, "loss": 2.0}]


def test_members_of_a_cache_are_in_range(tmp_path: Path) -> None:
    folder = made_cache(tmp_path)
    good = files.read_json(folder / "cache.json")
    for name, value in (("max_voxels", 0), ("views_deg", [0, 90, 180, 360]), ("seed", -1)):
        files.write_json(folder / "cache.json", good | {name: value})
        with pytest.raises(InputError, match=rf"cache\.json: {name}"):
            TargetCache.open(folder)
    files.write_json(folder / "cache.json", good)
    one = folder / "records" / "car-0.json"
    files.write_json(one, files.read_json(one) | {"voxels": 10**400})
    with pytest.raises(InputError, match=r"car-0\.json: voxels"):
        TargetCache.open(folder)
