"""Names from outside through ingest, sets, caches and the screening: refused, or shown as text.

An identity is named by plain letters; whatever else a file says is refused before a path is made
of it. Texts for people (kinds, colours, licences) may hold anything and must come out as text.
"""

from __future__ import annotations

import csv
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from recast.cli.recar_sets import Ingest
from recast.core import files
from recast.core.errors import InputError
from recast.recar import read_set, set_statistics, statistics_table
from recast.recar.screening import read_decisions, screened_vehicles, write_screening
from recast.recar.statistics import write_overview
from recast.recar.target_cache import TargetCache
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
