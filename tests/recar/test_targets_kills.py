"""The builder killed at any moment, and spread over processes: always the same bytes."""

from __future__ import annotations

import multiprocessing
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from recast.recar.target_cache import TargetCache, TargetRecord
from recast.recar.target_maker import TargetMaker, TargetOutcome, VehicleTask
from recast.recar.targets import build_targets
from support.moments import forked
from support.target_caches import box_target
from support.target_places import SETTINGS, Places
from support.vehicle_sets import tree


@pytest.mark.whole
@pytest.mark.skipif(sys.platform == "win32", reason="no fork")
def test_ten_kills_at_random_moments_change_nothing(
    places: Places, built: TargetCache, tmp_path: Path
) -> None:
    out = tmp_path / "cache"
    start = time.monotonic()
    build_targets(*places, tmp_path / "timed", SETTINGS)
    usual = time.monotonic() - start
    rng = random.Random(5)
    kills = 0
    while kills < 10:
        child = forked(lambda: build_targets(*places, out, SETTINGS))
        time.sleep(rng.uniform(0, usual / 2))
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        kills += 1
        if os.WIFEXITED(status):  # it had finished: start anew
            assert tree(out) == tree(built.folder)
            shutil.rmtree(out)
    build_targets(*places, out, SETTINGS)
    assert tree(out) == tree(built.folder)


class QuickMaker:
    """Makes boxes; the second vehicle fails."""

    def make(self, task: VehicleTask) -> TargetOutcome:
        index = int(task.id[-1])
        fields = {"id": task.id, "split": task.split, "kind": task.kind, "seed": index}
        if index == 1:
            return TargetOutcome(TargetRecord.model_validate(fields | {"failure": "made up"}))
        target = box_target(index)
        record = TargetRecord.model_validate(fields | {"voxels": len(target.coords)})
        return TargetOutcome(record, target, b"picture")


@pytest.mark.whole
@pytest.mark.skipif(sys.platform == "win32", reason="no fork")
@pytest.mark.parametrize("after", [False, True])
def test_a_kill_before_or_after_any_rename_changes_nothing(
    places: Places, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: bool
) -> None:
    monkeypatch.setattr(TargetMaker, "load", lambda *args: QuickMaker())
    expected = tree(build_targets(*places, tmp_path / "whole", SETTINGS).folder)
    rename = Path.replace

    def killed(at: int) -> Callable[[Path, Path], Path]:
        count = 0

        def replace(path: Path, target: Path) -> Path:
            nonlocal count
            count += 1
            if count == at and not after:
                os.kill(os.getpid(), signal.SIGKILL)
            found = rename(path, target)
            if count == at:
                os.kill(os.getpid(), signal.SIGKILL)
            return found

        return replace

    renames = 11  # cache.json twice, two vehicles with four files, one with its record alone
    for at in range(1, renames + 2):
        out = tmp_path / f"cache-{at}"
        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", killed(at))
            child = forked(lambda out=out: build_targets(*places, out, SETTINGS))  # type: ignore[misc]
            _, status = os.waitpid(child, 0)
        assert os.WIFSIGNALED(status) == (at <= renames)
        build_targets(*places, out, SETTINGS)
        assert tree(out) == expected


@pytest.mark.whole
def test_several_processes_give_the_same_bytes(
    places: Places, built: TargetCache, tmp_path: Path
) -> None:
    cache = build_targets(*places, tmp_path / "cache", SETTINGS, workers=2)
    assert tree(cache.folder) == tree(built.folder)
    assert torch.get_num_threads() == 1


@pytest.mark.slow
def test_a_killed_run_of_several_processes_ends_them_and_resumes(
    places: Places, built: TargetCache, tmp_path: Path
) -> None:
    out = tmp_path / "cache"
    context = multiprocessing.get_context("spawn")
    for _ in range(3):
        run = context.Process(
            target=build_targets, args=(*places, out, SETTINGS), kwargs={"workers": 2}
        )
        run.start()
        records = out / "records"
        before = len(list(records.glob("[!.]*.json"))) if records.exists() else 0
        while run.is_alive() and len(list(records.glob("[!.]*.json"))) <= before:
            time.sleep(0.01)
        assert run.pid is not None
        workers = _children(run.pid)
        run.kill()
        run.join()
        deadline = time.monotonic() + 30
        while any(Path(f"/proc/{pid}").exists() for pid in workers):
            assert time.monotonic() < deadline, "workers outlive a killed run"
            time.sleep(0.05)
    build_targets(*places, out, SETTINGS, workers=2)
    assert tree(out) == tree(built.folder)


def _children(pid: int) -> list[int]:
    """Processes that `pid` started (Linux); none elsewhere."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = path.read_text().rpartition(")")[2].split()[1]
        except OSError:
            continue
        if int(parent) == pid:
            found.append(int(path.parent.name))
    return found
