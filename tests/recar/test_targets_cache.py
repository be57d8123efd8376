"""The layout of a cache, what is accepted, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.recar.target_cache import Target, TargetCache, TargetRecord
from recast.recar.targets import target_statistics
from recast.recar.views import write_arrays
from support.target_caches import box_target, write_cache
from support.vehicle_sets import tree


@pytest.fixture
def cache(tmp_path: Path) -> TargetCache:
    return write_cache(tmp_path / "cache")


def assert_equal(found: Target, expected: Target) -> None:
    assert found.structure.dtype == np.float32 and found.coords.dtype == np.int32
    np.testing.assert_array_equal(found.structure, expected.structure)
    np.testing.assert_array_equal(found.coords, expected.coords)
    np.testing.assert_array_equal(found.latent, expected.latent)


def test_the_published_layout(cache: TargetCache) -> None:
    expected = box_target(0)
    with np.load(cache.folder / "ss_latents/tiny/car-0.npz") as file:
        assert file.files == ["mean"]
        assert file["mean"].shape == (8, 4, 4, 4) and file["mean"].dtype == np.float32
        np.testing.assert_array_equal(file["mean"], expected.structure)
    with np.load(cache.folder / "latents/tiny/car-0.npz") as file:
        assert set(file.files) == {"feats", "coords"}
        assert file["coords"].dtype == np.uint8 and file["feats"].dtype == np.float32
        np.testing.assert_array_equal(file["feats"], expected.latent)
    assert_equal(cache.target("car-0"), expected)


def test_ids_by_split_and_acceptance(cache: TargetCache) -> None:
    assert cache.ids(accepted_only=False) == ("car-0", "car-1", "car-2")
    assert cache.ids() == ("car-0", "car-1")
    assert cache.ids("train") == ("car-0",)
    assert cache.ids("held-out") == ("car-1",)
    with pytest.raises(KeyError):
        cache.target("car-3")


def test_decisions_reject_whatever_the_score(cache: TargetCache) -> None:
    path = cache.folder / "screening.csv"
    path.write_text("id,keep\ncar-1,no\ncar-0,yes\ncar-2,yes\n")
    assert TargetCache.open(cache.folder).ids() == ("car-0",)
    path.write_text(path.read_text().replace("car-0,yes", "car-0,maybe"))
    with pytest.raises(InputError, match=r"screening\.csv: line 3: keep: is 'maybe'"):
        TargetCache.open(cache.folder)


@pytest.mark.parametrize(
    ("coords", "problem"),
    [
        ([[1, 2, 3], [1, 2, 3]], "out of order or repeated"),
        ([[1, 2, 4], [1, 2, 3]], "out of order or repeated"),
        ([[-1, 2, 3], [1, 2, 3]], "negative"),
    ],
)
def test_voxels_in_disorder_are_refused(
    cache: TargetCache, coords: list[list[int]], problem: str
) -> None:
    values = {"feats": np.zeros((2, 8), np.float32), "coords": np.array(coords, np.int16)}
    write_arrays(cache.folder / "latents/tiny/car-0.npz", **values)
    with pytest.raises(InputError, match=problem):
        cache.target("car-0")


def test_the_figures_of_a_cache(cache: TargetCache) -> None:
    figures = target_statistics(cache)
    assert figures.done == 4 and figures.below == 1 and figures.rejected == 0
    assert figures.failures == {"the sampled structure is empty": 1}
    assert figures.accepted == {"train": 1, "held-out": 1}
    assert figures.scores == (0.2, 0.8, 0.9)


@pytest.mark.parametrize("size", [0, 10, 100])
def test_a_latent_cut_short_is_a_clear_line(cache: TargetCache, size: int) -> None:
    path = cache.folder / "latents/tiny/car-0.npz"
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(InputError, match=r"car-0\.npz: archive: cannot be read"):
        cache.target("car-0")


def test_a_missing_or_foreign_latent(cache: TargetCache) -> None:
    folder = cache.folder / "latents/tiny"
    (folder / "car-0.npz").write_bytes((folder / "car-1.npz").read_bytes())
    with pytest.raises(InputError, match="voxels"):
        cache.target("car-0")
    (folder / "car-0.npz").unlink()
    with pytest.raises(InputError, match="is missing"):
        cache.target("car-0")


def test_no_cache_one_in_the_making_and_a_lost_record(cache: TargetCache, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is missing"):
        TargetCache.open(tmp_path / "nothing")
    (cache.folder / "records/car-2.json").unlink()
    with pytest.raises(InputError, match=r"3, but cache\.json counts 4"):
        TargetCache.open(cache.folder)
    path = cache.folder / "cache.json"
    path.write_text(path.read_text().replace('"complete": true', '"complete": false'))
    with pytest.raises(InputError, match="still being made"):
        TargetCache.open(cache.folder)
    assert TargetCache.open(cache.folder, complete=False).ids() == ("car-0", "car-1")


def test_a_full_disk_loses_nothing(cache: TargetCache) -> None:
    """/dev/full refuses every byte, as a full disk does."""
    before = tree(cache.folder)
    record = TargetRecord(
        id="car-9", split="train", kind="van", seed=1, voxels=len(box_target(0).coords)
    )
    for name in ("ss_latents/tiny/.car-9.npz", "latents/tiny/.car-9.npz", "records/.car-9.json"):
        (cache.folder / f"{name}.partial").symlink_to("/dev/full")
        with pytest.raises(InputError, match="no space left"):
            cache.write_target(record, box_target(0))
        assert "car-9" not in cache.records
    assert "car-9" not in TargetCache.open(cache.folder).ids(accepted_only=False)
    assert before.items() <= tree(cache.folder).items()
    cache.write_target(record, box_target(0))
    assert "car-9" in cache.records


def test_record_and_target_must_agree(cache: TargetCache) -> None:
    record = TargetRecord(id="car-9", split="train", kind="van", seed=1, voxels=3)
    with pytest.raises(ValueError, match="voxels"):
        cache.write_target(record, box_target(0))
    with pytest.raises(ValueError, match="0 voxels"):
        cache.write_target(record, None)
