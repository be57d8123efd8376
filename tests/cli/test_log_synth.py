from __future__ import annotations

from pathlib import Path

import pytest

from recast.cli.main import main
from recast.logs import read_log
from recast.synthetic import SCENES, world_of

SCENE = "rural-two-lane"  # of few triangles


def refused(capsys: pytest.CaptureFixture[str], *args: str | Path) -> str:
    capsys.readouterr()
    assert main(["log", "synth", *(str(arg) for arg in args)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def test_a_log_is_made_and_its_world_can_be_made_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "log"
    size = ("--seconds", "0.2", "--width", "33", "--height", "17", "--workers", "1")
    assert main(["log", "synth", "--scene", SCENE, "--seed", "3", "--out", str(out), *size]) == 0
    assert "target track target" in " ".join(capsys.readouterr().out.split())
    log = read_log(out)
    assert log.cameras["front"].images[1].shape == (17, 33, 3)
    world = world_of(log)
    assert (world.name, world.seed, world.seconds) == (SCENE, 3, 0.2)
    assert set(log.tracks) <= set(world.vehicles)


def test_help_lists_all_scenes(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["log", "synth", "--help"])
    text = capsys.readouterr().out
    assert all(scene in text for scene in SCENES)


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "log"
    scene = ("--scene", SCENES[0], "--out", out)
    assert ", ".join(SCENES) in refused(capsys, "--scene", "moon", "--out", out)
    assert "negative" in refused(capsys, *scene, "--seed", "-1")
    assert "seconds" in refused(capsys, *scene, "--seconds", "0")
    assert "width" in refused(capsys, *scene, "--width", "8")
    assert "label noise" in refused(capsys, *scene, "--label-noise", "-1")
    out.mkdir()
    assert "exists already" in refused(capsys, *scene)
    assert not list(out.iterdir())
