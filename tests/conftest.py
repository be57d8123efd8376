"""Fixtures for all tests: one thread, and the folder of real drives where there is one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

import cv2
import pytest
from upath import UPath

from recast.core.workers import use_threads
from recast.logs import DrivingLog, read_log, write_log
from recast.logs.importers.kitti import load_kitti
from recast.splats import native
from support.tiny_drive import DRIVE, TinyDrive, write_tiny_drive

REPOSITORY = Path(__file__).resolve().parents[1]

use_threads(1)  # two OpenMP threads on a busy machine are ten times slower than one
cv2.setNumThreads(1)  # its pool does not survive a fork: a forked test would wait for it for ever


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip the slow tests, visibly, unless they are asked for."""
    if os.environ.get("RECAST_SLOW") == "1":
        return
    for item in items:
        if item.get_closest_marker("slow") is not None:
            item.add_marker(pytest.mark.skip(reason="slow: set RECAST_SLOW=1"))


@pytest.fixture(autouse=True)
def one_thread() -> None:
    """Commands set the threads of their process, here that of all later tests: begin with one."""
    use_threads(1)


@pytest.fixture(params=["avx512", "avx2", "portable"])
def isa(request: pytest.FixtureRequest) -> Iterator[str]:
    """Run the test on each instruction set that this machine has."""
    info = native.info()
    if request.param not in info.isas:
        pytest.skip(f"{request.param} not available: {info.reason or 'this machine has no such'}")
    native.set_isa(request.param)
    yield request.param
    native.set_isa(info.isa)


@pytest.fixture
def compiled() -> None:
    """Skip where there is no compiled rasterizer."""
    if not native.info().available:
        pytest.skip(native.info().reason)


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
    write_log(load_kitti(tiny_drive.root, DRIVE, tiny_drive.labels), out)
    return out


@pytest.fixture(scope="session")
def tiny_log(tiny_log_folder: Path) -> DrivingLog:
    """The tiny drive as a log, with images, sweeps, a moving ("0") and a parked ("1") track."""
    return read_log(tiny_log_folder)


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[UPath]:
    """An empty bucket of an S3-compatible server on this machine."""
    s3fs = pytest.importorskip("s3fs")
    moto = pytest.importorskip("moto.server")
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "testing")
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    s3fs.S3FileSystem.clear_instance_cache()  # it remembers the endpoints of other tests
    try:
        root = UPath(f"s3://store-{uuid4().hex[:12]}")
        root.mkdir()
        yield root
    finally:
        s3fs.S3FileSystem.clear_instance_cache()
        server.stop()
