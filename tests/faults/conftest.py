"""A run that nothing disturbed, to compare with."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.unbroken import Unbroken, unbroken


@pytest.fixture(scope="session")
def finished(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Unbroken:
    """A whole `recast run` at its smallest."""
    args = ["run", str(tiny_log_folder), "--track", "0", "--motion", "advancing-a"]
    args += ["--planner", "idm-follower"]
    args += ["--steps", "10", "--iterations", "4", "--scale", "0.5", "--threads", "1"]
    args += ["--generator", "support.own_parts:Box"]
    return unbroken(args, tmp_path_factory.mktemp("finished") / "1" / "run")


@pytest.fixture(scope="session")
def finished_grid(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Unbroken:
    """A whole `recast bench` at its smallest; nothing is rendered."""
    args = ["bench", "closed-loop", "--scenes", f"{tiny_log_folder}:0", "--samples", "100"]
    args += ["--motions", "advancing-a", "stationary-a", "--steps", "10"]
    return unbroken(args, tmp_path_factory.mktemp("grid") / "1" / "grid")
