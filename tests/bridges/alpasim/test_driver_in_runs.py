"""Runs and grids whose planner is a driver of AlpaSim, in another process than theirs."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from recast.cli.main import main
from recast_bridges.alpasim import client
from recast_bridges.alpasim import driver_session as module
from support.fake_driver import FakeDriver, driving

OPTIONS = ("--motions", "advancing-a", "--steps", "10", "--samples", "200")


@pytest.fixture(autouse=True)
def _no_versions_and_no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_VERSIONS", {})
    monkeypatch.setattr(client, "time", SimpleNamespace(sleep=lambda seconds: None))


def grid(log: Path, out: Path, port: int, *more: str, workers: int = 1) -> list[dict[str, Any]]:
    """The rows of a grid of both vehicles of the tiny drive, without images."""
    scenes = [f"{log}:0", f"{log}:1"]
    planner = f"alpasim:127.0.0.1:{port}/"
    command = ["bench", "closed-loop", "--scenes", *scenes, "--out", str(out), *OPTIONS]
    assert main([*command, "--planner", planner, "--workers", str(workers), *more]) == 0
    rows: list[dict[str, Any]] = pq.read_table(out / "rollouts.parquet").to_pylist()
    assert [row["planner"] for row in rows] == [planner] * 4
    return rows


@pytest.mark.whole
def test_a_grid_whose_driver_is_away_and_comes_back(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with driving(FakeDriver()) as port:
        pass
    for row in grid(tiny_log_folder, tmp_path / "grid", port):
        reason = f"127.0.0.1:{port}: get_version: UNAVAILABLE"
        assert row["failure_reason"].startswith(reason), row["failure_reason"]
        assert row["failure_reason"].endswith("; start the driver, or name its host and port")
    driver = FakeDriver()
    with driving(driver, port):
        rows = grid(tiny_log_folder, tmp_path / "grid", port, workers=2)
        assert [row["failure"] for row in rows] == [None] * 4
        assert {row["steps_run"] for row in rows} == {10}
        assert driver.refused == [] and driver.sessions == {}
        assert len(driver.drives) == 4
    other = FakeDriver(version="fake-driver-2")
    module._VERSIONS.clear()  # a new process
    with driving(other, port):
        grid(tiny_log_folder, tmp_path / "grid", port)
    assert len(other.drives) == 4  # nothing of the first driver is taken for the second one's
    records = (tmp_path / "store" / "rollouts").rglob("planner.json")
    drivers = [json.loads(path.read_text())["driver"] for path in records]
    assert sorted(drivers) == sorted(
        4 * ["fake-driver-1, git abc, API 0.54.0"] + 4 * ["fake-driver-2, git abc, API 0.54.0"]
    )
    assert "driver fake-driver-2, git abc, API 0.54.0" in capsys.readouterr().out.replace("\n", " ")


def test_a_faulty_plan_is_a_failed_row(tiny_log_folder: Path, tmp_path: Path) -> None:
    def faulty(reply: Any, number: int) -> Any:
        if number == 2:
            reply.trajectory.poses[1].pose.vec.x = np.inf
        return reply

    driver = FakeDriver(change=faulty)
    with driving(driver) as port:
        rows = grid(tiny_log_folder, tmp_path / "grid", port)
    assert driver.refused == [] and driver.sessions == {}
    for row in rows:
        assert f"127.0.0.1:{port}: drive: poses[1].pose.vec: is not finite" in row["failure_reason"]
    with driving(FakeDriver(), port):
        again = grid(tiny_log_folder, tmp_path / "grid", port, "--retry-failures")
    assert [row["failure"] for row in again] == [None] * 4


def test_a_run_without_its_driver_is_refused_before_anything_is_written(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with driving(FakeDriver()) as port:
        pass
    planner = f"alpasim:127.0.0.1:{port}"
    out = tmp_path / "run"
    command = ["run", str(tiny_log_folder), "--track", "0", "--out", str(out)]
    assert main([*command, "--planner", planner]) == 2
    told = capsys.readouterr().err
    assert f"127.0.0.1:{port}: get_version: UNAVAILABLE" in told
    assert not out.exists()
