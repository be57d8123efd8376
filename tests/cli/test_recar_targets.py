"""`recast recar targets`: what a user sees, and one line on bad input."""

from __future__ import annotations

from pathlib import Path

import pytest
import tyro

from recast.cli.recar import RecarTargets
from recast.core.errors import InputError
from support.trellis_folder import write_golden_model
from support.vehicle_pictures import write_vehicles


def run(*args: str | Path) -> None:
    tyro.cli(RecarTargets, args=[str(arg) for arg in args])()


def test_targets_of_a_set_and_the_same_command_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_vehicles(tmp_path / "set", 3)
    write_golden_model(tmp_path / "model")
    command = (
        tmp_path / "set",
        "--model",
        tmp_path / "model",
        "--out",
        tmp_path / "cache",
        "--max-voxels",
        "4096",
        "--steps",
        "4",
        "--limit",
        "2",
    )
    run(*command)
    text = capsys.readouterr().out
    assert "2 done, 0 without a target" in text
    assert "view-agreement" in text and "threshold 0.6" in text
    run(*command, "--threshold", "0")
    assert "2: 1 train, 1 held out" in capsys.readouterr().out
    with pytest.raises(InputError, match="latent_sampler: differs"):
        run(*command, "--steps", "2")
    with pytest.raises(InputError, match="mode: differs"):
        run(*command, "--multi-image", "multidiffusion")


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (("--limit", "0"), "`limit`: value: is 0"),
        (("--retries", "-1"), "`retries`: value: is -1"),
        (("--filter", "aesthetic"), "`predictor`: weights: are not given"),
        (("--model", "nowhere"), "nowhere: does not exist"),
        (("--workers", "0"), "`workers`: value: is 0"),
    ],
)
def test_bad_options_are_refused_before_any_work(
    tmp_path: Path, options: tuple[str, ...], problem: str
) -> None:
    write_vehicles(tmp_path / "set", 2)
    write_golden_model(tmp_path / "model")
    with pytest.raises(InputError) as caught:
        run(tmp_path / "set", "--model", tmp_path / "model", "--out", tmp_path / "cache", *options)
    assert problem in str(caught.value)
    assert not (tmp_path / "cache").exists()
