"""`recast recar ingest`: what a user sees, and one line on bad input."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from recast.cli.main import main
from recast.cli.recar_sets import Ingest
from recast.core.errors import InputError
from recast.recar import read_set
from support.vehicle_photographs import write_photos, write_rows


def test_bad_photographs_are_left_out_if_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photos = write_photos(tmp_path / "photos")
    (photos / "car-1" / "7.png").write_bytes(b"")
    options = {"licence": "CC0-1.0", "views": 4, "width": 60, "height": 40, "remover": "none"}
    with pytest.raises(InputError, match="1 of 3 cannot be used"):
        Ingest(photos, tmp_path / "set", **options)()  # type: ignore[arg-type]
    assert "car-1: " in capsys.readouterr().out
    Ingest(photos, tmp_path / "set", skip_bad=True, **options)()  # type: ignore[arg-type]
    said = capsys.readouterr().out
    assert "2 identities, 1 left out, 0 to look at" in said
    assert read_set(tmp_path / "set").identities.keys() == {"car-0", "car-2"}


def test_the_lines_of_skipped_vehicles_name_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photos = write_photos(tmp_path / "photos")
    options = {"licence": "CC0-1.0", "views": 8, "remover": "none", "layout": "mad-cars"}
    with pytest.raises(InputError, match="3 of 3 cannot be used"):
        Ingest(photos, tmp_path / "set", **options)()  # type: ignore[arg-type]
    said = capsys.readouterr().out
    assert "give fewer --views" in said and "`" not in said


def test_bad_options(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="folder: is missing"):
        Ingest(tmp_path, tmp_path / "set", "CC0-1.0", remover="nowhere")()


def test_refusals_name_the_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos = write_photos(tmp_path / "photos", 2)
    (photos / "car-1" / "9.png").unlink()
    begin, end = ["recar", "ingest", str(photos), "--licence", "CC0-1.0"], ["--views", "4"]
    command = [*begin, "--out", str(tmp_path / "set"), *end]
    assert main(command) == 2
    told = "".join(capsys.readouterr())
    assert "or give --views" in told and "leave them out with --skip-bad" in told
    assert main([*command, "--skip-bad"]) == 0
    (listed,) = json.loads((tmp_path / "set" / "ingest.json").read_text())["skipped"]
    assert listed["mend"] == "add the missing azimuths, or give --views"
    rows = [{"id": "car-0", "kind": "van", "azimuths_deg": "0 1 2 3"}]
    write_rows(photos, rows)  # type: ignore[arg-type]
    capsys.readouterr()
    assert main([*begin, "--out", str(tmp_path / "walk"), *end, "--layout", "mad-cars"]) == 2
    assert "give fewer --views, or a larger --azimuth-within" in "".join(capsys.readouterr())
