"""Beams without a return, and the scale of intensities, in the files of every dataset."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pyarrow import feather

from recast.logs import DrivingLog, LidarSweep, load_log, read_log, write_log
from recast.logs.importers.common import are_returns, unit_intensity
from support import tiny_argoverse2, tiny_drive, tiny_nuscenes, tiny_processed, tiny_py123d
from support.small_log import small_log

Change = Callable[[np.ndarray], None]
"""Writes another value into the places (N, 3) of points."""


def _floats(path: Path, width: int, place: slice, change: Change) -> None:
    rows = np.fromfile(path, np.float32).reshape(-1, width)
    change(rows[:, place])
    rows.tofile(path)


def _kitti(root: Path, change: Change) -> DrivingLog:
    drive = tiny_drive.write_tiny_drive(root)
    _floats(drive.folder / "velodyne_points/data/0000000000.bin", 4, slice(0, 3), change)
    options = {"refine": False, "with_map": False}
    return load_log(drive.root, importer="kitti", drive=tiny_drive.DRIVE, **options)


def _argoverse2(root: Path, change: Change) -> DrivingLog:
    folder = tiny_argoverse2.write_tiny_log(root)
    path = min((folder / "sensors/lidar").glob("*.feather"))
    table = feather.read_table(path, memory_map=False)
    places = np.stack([table[axis].to_numpy() for axis in "xyz"], axis=1)
    change(places)
    tiny_argoverse2.edit_table(path, **dict(zip("xyz", places.T, strict=True)))
    return load_log(root, importer="argoverse2", drive=tiny_argoverse2.LOG)


def _nuscenes(root: Path, change: Change) -> DrivingLog:
    tiny_nuscenes.write_tiny_nuscenes(root)
    path = min((root / "samples/LIDAR_TOP").glob("*.bin"))
    _floats(path, 5, slice(0, 3), change)
    return load_log(root, importer="nuscenes", drive=tiny_nuscenes.SCENE)


def _drivestudio(root: Path, change: Change) -> DrivingLog:
    scene = tiny_processed.write_drivestudio(root)
    _floats(scene / "lidar/000.bin", 14, slice(3, 6), change)
    return load_log(root, importer="drivestudio", drive=tiny_processed.SCENE)


def _street_gaussians(root: Path, change: Change) -> DrivingLog:
    scene = tiny_processed.write_street_gaussians(root)
    arrays = dict(np.load(scene / "pointcloud.npz"))
    change(arrays["000000"])
    np.savez(scene / "pointcloud.npz", **arrays)
    return load_log(root, importer="street-gaussians", drive=tiny_processed.SCENE)


READERS = {
    "argoverse2": _argoverse2,
    "drivestudio": _drivestudio,
    "kitti": _kitti,
    "nuscenes": _nuscenes,
    "street-gaussians": _street_gaussians,
}


def _first(log: DrivingLog) -> list[LidarSweep]:
    return [stream.sweeps[0] for stream in log.lidars.values()]


@pytest.fixture(scope="module", params=READERS)
def reader(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture(scope="module")
def whole(reader: str, tmp_path_factory: pytest.TempPathFactory) -> list[LidarSweep]:
    """First sweeps of a drive whose beams all return."""
    return _first(READERS[reader](tmp_path_factory.mktemp("whole"), lambda places: None))


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf], ids=str)
def test_a_beam_without_a_return_is_no_point(
    reader: str, whole: list[LidarSweep], value: float, tmp_path: Path
) -> None:
    log = READERS[reader](tmp_path / "gaps", lambda places: places[::3].__setitem__(..., value))
    kept = total = 0
    for sweep, before in zip(_first(log), whole, strict=True):
        sweep.validate("sweep")
        left = set(map(bytes, sweep.points))
        rows = np.array([row for row, point in enumerate(before.points) if bytes(point) in left])
        np.testing.assert_array_equal(sweep.points, before.points[rows])
        np.testing.assert_array_equal(sweep.intensity, before.intensity[rows])
        kept, total = kept + len(rows), total + len(before.points)
    assert total - kept == pytest.approx(total / 3, abs=1)


@pytest.mark.parametrize("value", [None, 0.0, np.nan], ids=str)
def test_py123d(value: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def cloud(self: Any, timestamp: int, lidar_id: int) -> Any:
        mount = tiny_py123d.LIDARS[2][1]
        points = np.array([[9.0, 1.0, 0.5], mount if value is None else [value] * 3], np.float32)
        intensity = np.array([0.25, 1.0])  # divided already
        return SimpleNamespace(
            point_cloud_3d=points, is_merged=False, ids=None, intensity=intensity, timestamps=None
        )

    monkeypatch.setattr(tiny_py123d.Scene, "get_lidar_at_timestamp", cloud)
    root = tiny_py123d.install(monkeypatch, tmp_path, tiny_py123d.Scene(merged=False))
    sweep = load_log(root, importer="py123d", drive=tiny_py123d.NAME).lidars["lidar_top"].sweeps[0]
    assert sweep.intensity.tolist() == [0.25]


def test_a_zero_that_was_moved_to_the_scanners_place_is_no_return_either() -> None:
    mount = np.array([1.35, 0.0, 1.64])
    points = np.array([mount, [0, 0, 0], mount + 0.2, [-5, 2, 1]], np.float16)  # as of Argoverse 2
    assert are_returns(points, mount).tolist() == [False, False, True, True]


def test_logs_that_were_stored_with_such_points_are_read_without(tmp_path: Path) -> None:
    log = small_log(np.random.default_rng(0))
    lidar = log.lidars["top"]
    sweep = lidar.sweeps[0]
    sweep.points[0] = lidar.rig_from_lidar[:3, 3]
    write_log(log, tmp_path / "log")
    stored = read_log(tmp_path / "log").lidars[lidar.name].sweeps[0]
    np.testing.assert_allclose(stored.points, sweep.points[1:], atol=1e-4)
    np.testing.assert_array_equal(stored.intensity, sweep.intensity[1:])


@pytest.mark.parametrize(
    ("stored", "expected"),
    [
        (np.array([0, 51, 255], np.uint8), [0.0, 0.2, 1.0]),
        (np.array([0.0, 51.0, 255.0, 300.0], np.float32), [0.0, 0.2, 1.0, 1.0]),
        (np.array([0.0, 0.2, 1.0], np.float32), [0.0, 0.2, 1.0]),
        (np.array([0, 1, 1], np.uint8), [0.0, 1 / 255, 1 / 255]),
    ],
)
def test_intensities_are_0_to_1_whichever_scale_a_file_has(
    stored: np.ndarray, expected: list[float]
) -> None:
    np.testing.assert_allclose(unit_intensity(stored), expected, atol=1e-6)
