"""Two commands in one folder: the second is told that the first is at work, and changes nothing."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from recast.cli.main import main
from recast.core import files
from recast.core.artefact import folder_hash
from recast.core.errors import InputError
from recast.logs import read_log
from recast.reconstruction import SceneConfig
from recast.reconstruction.train import claim_folder
from recast.runs.config import resolve_config
from recast.runs.run_folder import RunFolder
from recast.studies import resolve_bench
from recast.studies.grid import begin


def names(folder: Path) -> dict[str, int]:
    return {str(path): path.stat().st_mtime_ns for path in folder.rglob("*")}


def refused(capsys: pytest.CaptureFixture[str], out: Path, *command: str) -> None:
    before = names(out)
    with files.alone_in(out):
        assert main([*command, "--out", str(out)]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert "another process is at work here" in line
    assert names(out) == before


def test_a_run(tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = resolve_config("0", ["advancing-a"], None, None, {}, {})
    log, out = tiny_log_folder, tmp_path / "run"
    store = str(tmp_path / "store")
    RunFolder.create_or_resume(out, config.resolved(), log, folder_hash(log), store)
    refused(capsys, out, "run", str(log), "--track", "0", "--motion", "advancing-a")
    assert not Path(store).exists()


def test_a_grid(tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [f"{tiny_log_folder}:0"]
    settings = resolve_bench(
        words=words,
        track=None,
        motions=["advancing-a"],
        quick=False,
        config_file=None,
        scene_config_file=None,
        samples=100,
        drive_options={},
        run_options={"films": False},
        scene_options={},
    )
    begin(tmp_path, settings.record())
    command = ["bench", "closed-loop", "--scenes", *words, "--motions", "advancing-a"]
    refused(capsys, tmp_path, *command, "--samples", "100")


def test_a_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused(capsys, tmp_path, "demo", "--quick")


def test_what_a_killed_command_held_is_free(tmp_path: Path) -> None:
    with pytest.raises(InputError), files.alone_in(tmp_path), files.alone_in(tmp_path):
        pass
    with files.alone_in(tmp_path):
        pass


@pytest.mark.parametrize("module", ["embreex.rtcore_scene", "embreex.mesh_construction"])
def test_a_demo_without_the_ray_tracer_asks_for_it_before_anything_begins(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, module: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    assert main(["demo", "--quick", "--out", str(tmp_path / "demo")]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "embreex" in shown.err and "pip install" in shown.err
    assert not (tmp_path / "demo").exists()


def test_a_training(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ("scene", "train", str(tiny_log_folder), "--iterations", "1", "--threads", "1")
    config = SceneConfig(iterations=1, threads=1)
    claim_folder(tmp_path, read_log(tiny_log_folder), config)
    refused(capsys, tmp_path, *command)
