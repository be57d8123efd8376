"""A small drive of box-shaped cars, and its log, shared by the tests of this folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from recast.logs import DrivingLog, read_log
from recast.synthetic.world import World
from recast.synthetic.write import synthesize_log
from support.small_street import small_world


@pytest.fixture(scope="session")
def small() -> World:
    return small_world()


@pytest.fixture(scope="session")
def small_log_folder(small: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("synthetic") / "log"
    synthesize_log(small, out, width=48, height=32, workers=1, truth=True)
    return out


@pytest.fixture(scope="session")
def small_log(small_log_folder: Path) -> DrivingLog:
    return read_log(small_log_folder)
