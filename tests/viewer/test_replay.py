"""Replays: one file, no larger than asked for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.viewer import ViewInputs, write_replay
from support.gaussian_clouds import grey_gaussians

pytest.importorskip("viser")


def test_a_file_keeps_everything_where_it_fits(inputs: ViewInputs, tmp_path: Path) -> None:
    path = tmp_path / "replay.html"
    size = write_replay(inputs, path)
    assert size.kept == size.total and size.bytes == path.stat().st_size < 3e6
    assert "__VISER_EMBED_DATA__" in path.read_text()


def test_gaussians_are_left_out_until_it_fits(inputs: ViewInputs, tmp_path: Path) -> None:
    scene = inputs.scenes["native"]
    assert scene is not None
    points = np.random.default_rng(0).normal(size=(60_000, 3)) * [20, 20, 1]
    crowded = replace(scene, background=grey_gaussians(points, 0.1))
    drives = {"recording": {"native": inputs.scenarios["advancing-a"]["native"]}}
    shown = replace(inputs, scenes={"native": crowded}, scenarios=drives)
    size = write_replay(shown, tmp_path / "replay.html", most_mb=1.5)
    assert 0 < size.kept < size.total
    assert 1.2e6 < size.bytes <= 1.5e6


def test_what_cannot_be_small_enough_is_refused(inputs: ViewInputs, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is at least .* MB"):
        write_replay(inputs, tmp_path / "replay.html", most_mb=0.1)
    with pytest.raises(InputError, match="choose one of advancing-a, recording"):
        write_replay(inputs, tmp_path / "replay.html", scenario="none")
    assert not list(tmp_path.iterdir())
