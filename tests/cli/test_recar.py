"""`recast recar`: one line on bad input, and what a user sees."""

from __future__ import annotations

from pathlib import Path

import pytest

from recast.cli.main import main

pytest.importorskip("embreex")

SYNTH = ("recar", "synth", "--views", "2", "--width", "32", "--height", "24", "--vehicles")


def run(capsys: pytest.CaptureFixture[str], *args: str | Path) -> tuple[int, str, str]:
    capsys.readouterr()
    code = main([str(arg) for arg in args])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_make_a_set_count_it_and_draw_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "set"
    code, _, _ = run(capsys, *SYNTH, "2", "--kinds", "sedan", "van", "--out", out)
    assert code == 0
    assert len(list(out.glob("vehicle-*/view_*.png"))) == 4
    code, text, _ = run(capsys, "recar", "stats", out, "--sheet", tmp_path / "sheet.png")
    assert code == 0
    assert "1 train, 1 held out" in text
    assert (tmp_path / "sheet.png").stat().st_size > 10_000
    (out / "vehicle-00001" / "view_01.png").unlink()
    code, _, line = run(capsys, "recar", "stats", out)
    assert code == 2
    assert "view_01.png: view: is missing" in line


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("-3",), "--vehicles: value: is -3"),
        (("1", "--width", "0"), "--width: value: is 0"),
        (("1", "--workers", "-1"), "--workers: value: is -1"),
        (("1", "--kinds", "boat"), "--kinds: boat: is unknown; choose from hatchback"),
        (("1", "--mesh", "nowhere.obj"), "nowhere.obj: mesh: is missing"),
    ],
)
def test_bad_input_is_one_line(
    args: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = run(capsys, *SYNTH, *args, "--out", tmp_path / "set")
    assert code == 2
    assert err.count("\n") == 1
    assert err.startswith(f"recast: {message}")
    assert not (tmp_path / "set").exists()


def test_a_folder_of_something_else_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    code, _, err = run(capsys, *SYNTH, "1", "--out", tmp_path)
    assert code == 2
    assert "exists and is not a vehicle set" in err
    code, _, err = run(capsys, "recar", "stats", tmp_path / "none")
    assert code == 2
    assert "vehicle set: is missing" in err
