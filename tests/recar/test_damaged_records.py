"""Every JSON file that the adaptation reads, damaged in the ways that JSON allows."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from recast.core import files
from recast.core.errors import InputError
from recast.recar import read_real_crops, read_set
from recast.recar.ingest import read_doubts
from recast.recar.ingest_table import read_table
from recast.recar.perturb import read_perturbations
from recast.recar.target_cache import TargetCache
from recast.recar.training_config import read_stage_config, read_training_record
from recast.training.loop import train
from recast.training.state import STATE_FILE, steps_done
from recast.training.task import read_log_lines
from recast_tools.small_model.asset_synthesis import AssetsRecord, make_assets
from support.crops import write_crops
from support.line_task import SETTINGS, Line
from support.target_caches import write_cache
from support.vehicle_sets import write_set

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
