"""Killed before any change of the disk, the same call ends in the same bytes; refused, in one line.

Moments are numbered changes (files opened to be written, made, renamed, removed), so that a run
that fails can be repeated; see `support.moments`.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from recast.core import files
from recast.core.errors import InputError
from recast.recar import read_set
from recast.recar.ingest import ingest_photographs
from recast.recar.screening import read_decisions, screened_vehicles, write_screening
from recast.recar.targets import build_targets
from recast.training.loop import train
from support.line_task import SETTINGS as TRAINING
from support.line_task import Line
from support.moments import changes_of, killed_before, said_on_a_full_disk, said_on_a_read_only_disk
from support.target_places import SETTINGS as TARGETS
from support.target_places import Places
from support.tiny_stage import TinyStage, train_quietly, write_tiny_stage
from support.vehicle_photographs import SETTINGS as PHOTOS
from support.vehicle_photographs import write_photos
from support.vehicle_sets import tree, write_set

KILLS = 10
STAGE = pytest.param("stage", marks=pytest.mark.whole)
Run = Callable[[Path], object]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no fork")


def moments(changes: int) -> list[int]:
    """Evenly through the run, the first and the last change among them."""
    return sorted({int(i) for i in np.linspace(0, changes - 1, KILLS).round()})


def untimed(folder: Path) -> dict[str, bytes]:
    """All files but those that hold seconds."""
    timed = ("log.jsonl", "training.json")
    return {name: data for name, data in tree(folder).items() if not name.endswith(timed)}


def survives(run: Run, tmp_path: Path) -> None:
    """Kill at each moment, run again, and compare with a run that nothing met."""
    # The name of the folder is in some records.
    whole, out = tmp_path / "whole" / "out", tmp_path / "killed" / "out"
    for folder in (whole, out):
        folder.parent.mkdir()
    changes = changes_of(lambda: run(whole), whole)
    expected = untimed(whole)
    for moment in moments(changes):
        assert killed_before(moment, lambda: run(out), out), f"change {moment} of {changes}"
        run(out)
        assert untimed(out) == expected, f"killed before change {moment} of {changes}"
        shutil.rmtree(out)
    assert not killed_before(changes, lambda: run(out), out)


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_photos(tmp_path_factory.mktemp("photos") / "photos")


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> TinyStage:
    return write_tiny_stage(tmp_path_factory.mktemp("stage"))


@pytest.fixture(scope="module")
def runs(photos: Path, stage: TinyStage, places: Places) -> dict[str, Run]:
    """What writes, by name."""
    steps = {"steps": 2, "checkpoint_every": 1, "log_every": 1}
    return {
        "ingest": lambda out: ingest_photographs(photos, out, PHOTOS, None),
        "targets": lambda out: build_targets(*places, out, TARGETS, identities=["car-0"]),
        "training": lambda out: train(Line(), TRAINING, out),
        "stage": lambda out: train_quietly(
            stage.request(out, structure=steps, latent=steps, sheet_every=2)
        ),
    }


@pytest.mark.parametrize("name", ["ingest", "training", STAGE])
def test_kills_change_nothing(runs: dict[str, Run], tmp_path: Path, name: str) -> None:
    """Of targets see test_targets.py."""
    survives(runs[name], tmp_path)


def test_a_training_killed_between_changes_repeats_its_steps(tmp_path: Path) -> None:
    """At ten steps: what was not yet written is trained again."""
    whole = tmp_path / "whole"
    train(Line(), TRAINING, whole)
    expected = untimed(whole)
    for step in np.linspace(0, TRAINING.steps - 1, KILLS).round().astype(int):
        out = tmp_path / str(step)
        with pytest.raises(KeyboardInterrupt):
            train(Line(stop_at=int(step)), TRAINING, out)
        train(Line(), TRAINING, out)
        assert untimed(out) == expected, step


@pytest.mark.parametrize("name", ["ingest", "targets", "training", STAGE])
def test_a_read_only_disk_is_one_line(runs: dict[str, Run], tmp_path: Path, name: str) -> None:
    out = tmp_path / "out"
    said = said_on_a_read_only_disk(lambda: runs[name](out), out)
    assert "cannot be written to, it is read-only" in said
    assert not out.exists() or not tree(out)
    begun = tmp_path / "begun"
    changes = changes_of(lambda: runs[name](tmp_path / "whole"), tmp_path / "whole")
    assert killed_before(changes // 2, lambda: runs[name](begun), begun)
    before = tree(begun)
    said = said_on_a_read_only_disk(lambda: runs[name](begun), begun)
    assert "cannot be written to, it is read-only" in said
    assert tree(begun) == before


@pytest.mark.parametrize("size", [0, 700])
@pytest.mark.parametrize("name", ["ingest", "targets", "training", STAGE])
def test_a_disk_without_room_is_one_line_and_the_same_call_goes_on(
    runs: dict[str, Run], tmp_path: Path, name: str, size: int
) -> None:
    out = tmp_path / "parent" / "out"
    said = said_on_a_full_disk(lambda: runs[name](out), size)
    assert ": disk: " in said
    assert not [name for name in tree(tmp_path) if ".partial" in name]
    runs[name](out)
    runs[name](tmp_path / "out")
    assert untimed(out) == untimed(tmp_path / "out")


@pytest.mark.parametrize("name", ["ingest", "targets", "training", STAGE])
def test_a_second_process_is_told_that_the_first_is_at_work(
    runs: dict[str, Run], tmp_path: Path, name: str
) -> None:
    out = tmp_path / "out"
    assert killed_before(6, lambda: runs[name](out), out)  # it has hardly begun
    busy = out / "training" / "structure" if name == "stage" else out
    busy.mkdir(parents=True, exist_ok=True)
    before = tree(out)
    with files.alone_in(busy), pytest.raises(InputError, match="another process is at work"):
        runs[name](out)
    assert {n: d for n, d in tree(out).items() if n in before} == before
    runs[name](out)


def test_a_table_of_decisions_is_whole_and_never_lost(tmp_path: Path) -> None:
    """Screened again, what the person wrote stays whatever happens in between."""
    cars = write_set(tmp_path / "set", 3)
    table = cars.folder / "screening.csv"

    def screen() -> None:
        found = read_set(cars.folder)
        write_screening(found.folder, found.identities, screened_vehicles(found))

    screen()
    table.write_text(table.read_text().replace("not checked,,", "not checked,no,rust", 1))
    screen()
    before = tree(cars.folder)
    assert ": disk: " in said_on_a_full_disk(screen)
    assert "read-only" in said_on_a_read_only_disk(screen, cars.folder)
    for change in range(changes_of(screen, cars.folder)):
        killed_before(change, screen, cars.folder)
        assert read_decisions(cars.folder, cars.identities) == {"car-0": "no"}
    screen()
    assert {n: d for n, d in tree(cars.folder).items() if ".partial" not in n} == before
