"""Training assets: views, voxels, files, and that voxels lie where the pictures show them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.geometry import boxes, se3
from recast.recar.training_conditions import read_asset, write_asset
from recast_tools.small_model.asset_synthesis import sample_views, voxelise


def test_voxels_know_colour_normal_centroid_and_parts() -> None:
    points = np.array([[0.01, 0.01, 0.01], [0.02, 0.01, 0.01], [-0.49, 0.3, 0.0], [0.9, 0, 0]])
    colours = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [1, 1, 1]])
    normals = np.array([[0, 0, 1.0], [0, 0, 1.0], [-1.0, 0, 0], [0, 1.0, 0]])
    coords, features = voxelise(points, colours, normals, 8, least=1)
    assert coords.tolist() == [[0, 6, 4], [4, 4, 4]]  # lexicographic; the last lies outside
    first, second = features.astype(float)
    np.testing.assert_allclose(second[:3], [0, 0, -1], atol=1e-3)  # mean of red and green
    np.testing.assert_allclose(second[3:6], [0, 0, 1], atol=1e-3)
    np.testing.assert_allclose(second[6:9], [0.12 - 0.5, 0.08 - 0.5, 0.08 - 0.5], atol=1e-3)
    assert second[9:].tolist() == [1, 0, 0, 0, 0, 0, 0, 0]
    assert first[9:].sum() == 1


def test_lonely_points_make_no_voxel() -> None:
    one = np.array([[0.1, 0.1, 0.1]])
    coords, features = voxelise(one, one, one, 8, least=2)
    assert coords.shape == (0, 3)
    assert features.shape == (0, 17)


@pytest.mark.parametrize("extents", [(1.0, 0.4, 0.35), (0.5, 1.0, 0.2), (0.3, 0.3, 1.0)])
def test_every_view_holds_the_whole_asset(extents: tuple[float, float, float]) -> None:
    size = np.array(extents)
    for view in sample_views(np.random.default_rng(3), size, 6, 10, 128):
        points = se3.apply(se3.inverse(view.pose), boxes.corners(size))
        pixels = view.focal * points[:, :2] / points[:, 2:] + 64
        assert pixels.min() > 0
        assert pixels.max() < 128
        assert (pixels.max(axis=0) - pixels.min(axis=0)).max() > 90  # and fills it


def test_crops_stand_as_low_as_a_car_and_look_level() -> None:
    views = sample_views(np.random.default_rng(0), np.array([1.0, 0.4, 0.4]), 40, 40, 64)
    heights = [np.degrees(np.arcsin(v.pose[2, 3] / np.linalg.norm(v.pose[:3, 3]))) for v in views]
    assert -0.01 <= min(heights[:40]) <= max(heights[:40]) <= 15.01
    assert min(heights[40:]) < 0 < 40 < max(heights[40:])
    assert all(abs(v.pose[2, 0]) < 1e-9 for v in views)  # the image's x axis is level


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("embreex")
    from recast_tools.small_model.asset_synthesis import AssetsRecord, make_assets

    folder = tmp_path_factory.mktemp("assets")
    make_assets(folder, 4, AssetsRecord(seed=5, crops=2, around=3, pixels=48))
    return folder


def test_voxels_lie_where_the_pictures_show_them(made: Path) -> None:
    asset = read_asset(made / "asset-00000.npz")
    assert asset.features.shape == (len(asset.coords), 17)
    centres = (asset.coords.astype(float) + 0.5) / 32 - 0.5
    side = asset.pictures.shape[1]
    for pose, focal, picture in zip(asset.poses, asset.focal, asset.pictures, strict=True):
        points = se3.apply(pose.astype(float), centres)
        pixels = np.round(focal * points[:, :2] / points[:, 2:] + side / 2 - 0.5).astype(int)
        on = picture[pixels[:, 1].clip(0, side - 1), pixels[:, 0].clip(0, side - 1), 3] > 0
        assert on.mean() > 0.9


def test_every_fourth_is_a_shape_and_files_come_back(made: Path, tmp_path: Path) -> None:
    kinds = [read_asset(made / f"asset-0000{i}.npz").kind for i in range(4)]
    assert [kind.startswith("shape") for kind in kinds] == [False, False, False, True]
    asset = read_asset(made / "asset-00001.npz")
    write_asset(tmp_path / "a.npz", asset)
    again = read_asset(tmp_path / "a.npz")
    assert np.array_equal(again.pictures, asset.pictures)
    assert np.array_equal(again.features, asset.features)
    assert again.crops == 2


def test_any_number_of_workers_and_any_restart_give_the_same_bytes(
    made: Path, tmp_path: Path
) -> None:
    from recast_tools.small_model.asset_synthesis import AssetsRecord, make_assets

    record = AssetsRecord(seed=5, crops=2, around=3, pixels=48)
    make_assets(tmp_path, 1, record)
    make_assets(tmp_path, 4, record, workers=2)
    for path in sorted(made.iterdir()):
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()
    with pytest.raises(InputError, match=r"assets\.json: settings: differ"):
        make_assets(tmp_path, 4, record.model_copy(update={"seed": 6}))


def test_a_file_cut_short_is_one_line(made: Path, tmp_path: Path) -> None:
    path = tmp_path / "asset-00000.npz"
    path.write_bytes((made / "asset-00000.npz").read_bytes()[:3000])
    with pytest.raises(InputError, match=r"asset-00000\.npz: archive: cannot be read"):
        read_asset(path)
    with pytest.raises(InputError, match="is missing"):
        read_asset(tmp_path / "none.npz")
