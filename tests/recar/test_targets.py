"""Targets of a set: built, resumed after kills, and recorded."""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.recar import read_set
from recast.recar.target_cache import TargetCache, TargetRecord
from recast.recar.target_maker import (
    FilterSettings,
    ModelSource,
    TargetMaker,
    TargetOutcome,
    TargetSettings,
    VehicleTask,
    identity_seed,
)
from recast.recar.targets import build_targets
from recast.trellis import GenerationLimits, generate
from support.moments import forked
from support.target_caches import box_target
from support.target_places import SETTINGS, Places
from support.vehicle_pictures import shape
from support.vehicle_sets import tree


def test_targets_are_those_of_the_multi_image_pipeline(places: Places, built: TargetCache) -> None:
    vehicles, source = places
    assert built.ids(accepted_only=False) == ("car-0", "car-1", "car-2")
    model = source.load("cpu")
    for index, name in enumerate(vehicles.identities):
        views = [shape(index, view) for view in (0, 2, 1, 3)]
        made = generate(
            model, [views], [identity_seed(0, name)], limits=GenerationLimits(4096)
        ).vehicles[0]
        target, record = built.target(name), built.records[name]
        np.testing.assert_array_equal(target.structure, made.structure.numpy())
        np.testing.assert_array_equal(target.coords, made.coords.numpy())
        np.testing.assert_array_equal(target.latent, made.latent.numpy())
        assert record.seed == identity_seed(0, name) and record.voxels == len(made.coords)
        assert record.gaussians == len(made.gaussians) and record.score is not None
        assert built.preview_path(name).read_bytes().startswith(b"\x89PNG")
    assert built.records["car-1"].split == "held-out"
    assert built.record.views_deg == (0.0, 180.0, 90.0, 270.0)
    assert built.record.structure_sampler.steps == 6 and built.record.mode == "stochastic"
    assert (built.record.identities, built.record.failures) == (3, 0)


def test_seeds_depend_on_seed_and_name_alone() -> None:
    seeds = {identity_seed(seed, f"car-{i}") for seed in range(3) for i in range(300)}
    assert len(seeds) == 900 and min(seeds) >= 0 and max(seeds) < 2**31
    assert identity_seed(0, "car-0") == 1811316280  # caches already made rely on it


def test_again_touches_nothing_and_another_threshold_one_file(
    places: Places, built: TargetCache, tmp_path: Path
) -> None:
    out = tmp_path / "cache"
    shutil.copytree(built.folder, out)
    times = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    again = build_targets(*places, out, SETTINGS)
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == times
    assert again.ids() == ()
    low = SETTINGS.model_copy(update={"filter": FilterSettings(threshold=0.001)})
    assert build_targets(*places, out, low).ids() == ("car-0", "car-1", "car-2")
    changed = [p for p, t in times.items() if p.is_file() and p.stat().st_mtime_ns != t]
    assert changed == [out / "cache.json"]


def test_a_cache_grows_to_the_same_bytes(
    places: Places, built: TargetCache, tmp_path: Path
) -> None:
    part = build_targets(*places, tmp_path / "cache", SETTINGS, identities=["car-1"])
    assert list(part.records) == ["car-1"] and part.record.complete
    seen: list[tuple[int, int]] = []
    build_targets(*places, part.folder, SETTINGS, progress=lambda *done: seen.append(done))
    assert tree(part.folder) == tree(built.folder)
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_other_settings_or_another_folder_are_refused(
    places: Places, built: TargetCache, tmp_path: Path
) -> None:
    before = tree(built.folder)
    for settings, field in (
        (SETTINGS.model_copy(update={"seed": 1}), "seed"),
        (SETTINGS.model_copy(update={"mode": "multidiffusion"}), "mode"),
        (SETTINGS.model_copy(update={"filter": FilterSettings(kind="none")}), "filter"),
    ):
        with pytest.raises(InputError, match=f"{field}: differs"):
            build_targets(*places, built.folder, settings)
    other = tmp_path / "model"
    shutil.copytree(places[1].folder, other)
    weights = other / "ckpts/ss_dec.safetensors"
    data = bytearray(weights.read_bytes())
    data[-1] ^= 1
    weights.write_bytes(data)
    with pytest.raises(InputError, match="model: differs"):
        build_targets(places[0], ModelSource(other), built.folder, SETTINGS)
    assert tree(built.folder) == before
    with pytest.raises(InputError, match="is not a target cache"):
        build_targets(*places, other, SETTINGS)
    with pytest.raises(InputError, match="car-9: is not in the set"):
        build_targets(*places, tmp_path / "new", SETTINGS, identities=["car-9"])
    with pytest.raises(InputError, match="workers"):
        build_targets(*places, tmp_path / "new", SETTINGS, workers=0)
    assert not (tmp_path / "new").exists()


def test_failures_are_recorded_and_the_others_go_on(
    places: Places, built: TargetCache, tmp_path: Path
) -> None:
    folder = tmp_path / "set"
    shutil.copytree(places[0].folder, folder)
    picture = folder / "car-1/view_02.png"
    sound = picture.read_bytes()
    picture.write_bytes(sound[:-60])
    broken = read_set(folder)
    cache = build_targets(broken, places[1], tmp_path / "cache", SETTINGS)
    assert cache.ids(accepted_only=False) == ("car-0", "car-2")
    assert cache.records["car-1"].failure.startswith("view 2: view cannot be decoded (")
    assert cache.record.failures == 1
    assert not cache.preview_path("car-1").exists()
    picture.write_bytes(sound)
    again = build_targets(broken, places[1], cache.folder, SETTINGS)
    assert again.records["car-1"].failure is not None
    build_targets(broken, places[1], cache.folder, SETTINGS, retry_failures=True)
    assert tree(cache.folder) == tree(built.folder)


def test_a_structure_that_is_too_large_is_a_failure_after_all_retries(
    places: Places, tmp_path: Path
) -> None:
    settings = TargetSettings(max_voxels=1, retries=1)
    cache = build_targets(*places, tmp_path / "cache", settings, identities=["car-0"])
    reason = cache.records["car-0"].failure
    assert reason is not None and "at most 1 are allowed" in reason
    assert cache.ids(accepted_only=False) == ()


def test_a_full_disk_ends_in_one_line_and_the_same_command_goes_on(
    places: Places, built: TargetCache, tmp_path: Path
) -> None:
    out = tmp_path / "cache"
    folder = out / "latents/model"
    folder.mkdir(parents=True)
    shutil.copy(built.folder / "cache.json", out)
    path = out / "cache.json"
    path.write_text(path.read_text().replace('"complete": true', '"complete": false'))
    (folder / ".car-1.npz.partial").symlink_to("/dev/full")  # refuses every byte
    with pytest.raises(InputError, match="no space left"):
        build_targets(*places, out, SETTINGS)
    assert list(TargetCache.open(out, complete=False).records) == ["car-0"]
    build_targets(*places, out, SETTINGS)
    assert tree(out) == tree(built.folder)


def test_a_model_that_cannot_be_read_is_one_line_before_any_work(
    places: Places, tmp_path: Path
) -> None:
    folder = tmp_path / "model"
    shutil.copytree(places[1].folder, folder)
    (folder / "ckpts/slat_flow.safetensors").write_bytes(b"short")
    with pytest.raises(InputError, match=r"slat_flow\.safetensors"):
        build_targets(places[0], ModelSource(folder), tmp_path / "cache", SETTINGS)
    (folder / "ckpts/slat_flow.safetensors").unlink()
    with pytest.raises(InputError, match=r"pipeline\.json"):
        build_targets(places[0], ModelSource(folder), tmp_path / "cache", SETTINGS)
    records = tmp_path / "cache/records"
    assert not records.exists()


def test_ray_is_asked_for_by_name_where_it_is_missing(
    places: Places, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"recast-sim\[distributed\]"):
        build_targets(*places, tmp_path / "cache", SETTINGS, ray="local")
    assert not (tmp_path / "cache").exists()


def test_cache_json_says_how_the_targets_were_made(built: TargetCache) -> None:
    written = json.loads((built.folder / "cache.json").read_text())
    assert written["format"] == "recast-target-cache" and written["complete"] is True
    assert written["model"]["name"] == "model" and len(written["model"]["sha256"]) == 64
    assert len(written["model"]["latent_mean"]) == 8
    assert written["filter"] == {"score": "view-agreement", "threshold": 0.6, "weights": {}}


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
