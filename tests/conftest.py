"""Fixtures for all tests: one thread, and the folder of real drives where there is one."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch

from recast.logs import DrivingLog, read_log
from recast.logs.importers.kitti import import_kitti
from support.tiny_drive import DRIVE, TinyDrive, write_tiny_drive

REPOSITORY = Path(__file__).resolve().parents[1]

torch.set_num_threads(1)  # two OpenMP threads on a busy machine are ten times slower than one


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip the slow tests, visibly, unless they are asked for."""
    if os.environ.get("RECAST_SLOW") == "1":
        return
    for item in items:
        if item.get_closest_marker("slow") is not None:
            item.add_marker(pytest.mark.skip(reason="slow: set RECAST_SLOW=1"))


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with real drives and golden vectors; tests that need it skip without it."""
    folder = Path(os.environ.get("RECAST_SHARED", REPOSITORY.parent / "shared"))
    if not (folder / "data").is_dir():
        pytest.skip(f"real data not found at {folder}: set RECAST_SHARED")
    return folder


@pytest.fixture(scope="session")
def kitti_0013(shared: Path) -> Path:
    """KITTI raw drive 2011_09_26_0013 with its tracking labels."""
    folder = shared / "data" / "kitti_0013"
    if not folder.is_dir():
        pytest.skip(f"{folder} not found")
    return folder


@pytest.fixture(scope="session")
def tiny_drive(tmp_path_factory: pytest.TempPathFactory) -> TinyDrive:
    """A small made-up drive in KITTI raw layout: `.root`, `.labels`; its name is `DRIVE`."""
    return write_tiny_drive(tmp_path_factory.mktemp("tiny_drive"))


@pytest.fixture(scope="session")
def tiny_log_folder(tiny_drive: TinyDrive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny drive, imported."""
    out = tmp_path_factory.mktemp("tiny_log") / "log"
    import_kitti(tiny_drive.root, DRIVE, out, tiny_drive.labels)
    return out


@pytest.fixture(scope="session")
def tiny_log(tiny_log_folder: Path) -> DrivingLog:
    """The tiny drive as a log, with images, sweeps, a moving ("0") and a parked ("1") track."""
    return read_log(tiny_log_folder)
