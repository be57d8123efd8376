"""`cameras` of every importer: those named are imported, an unknown name is answered with all."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.logs import read_log
from recast.logs.importers.waymo_proto import CAMERA_NAME, LASER_NAME, lidar_name
from support import (
    tiny_argoverse2,
    tiny_nuscenes,
    tiny_processed,
    tiny_py123d,
    tiny_waymo,
    tiny_waymo2,
)
from support.importing import import_drive

WRITE: dict[str, tuple[Callable[[Path], object], str]] = {
    "argoverse2": (tiny_argoverse2.write_tiny_log, tiny_argoverse2.LOG),
    "drivestudio": (tiny_processed.write_drivestudio, tiny_processed.SCENE),
    "nuscenes": (tiny_nuscenes.write_tiny_nuscenes, tiny_nuscenes.SCENE),
    "street-gaussians": (tiny_processed.write_street_gaussians, tiny_processed.SCENE),
    "waymo": (tiny_waymo.write_segment, tiny_waymo.NAME),
    "waymo-v2": (tiny_waymo2.write_segment, tiny_waymo.NAME),
}


@pytest.mark.parametrize("name", [*WRITE, "py123d"])
def test_the_cameras_named_are_imported(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "root"
    if name == "py123d":
        tiny_py123d.install(monkeypatch, root, tiny_py123d.Scene())
        drive = tiny_py123d.NAME
    else:
        write, drive = WRITE[name]
        write(root)
    importer = partial(import_drive, name, root, drive)
    importer(tmp_path / "all")
    whole = read_log(tmp_path / "all")
    *_, last = whole.cameras
    importer(tmp_path / "one", cameras=[last])
    one = read_log(tmp_path / "one")
    assert list(one.cameras) == [last]
    assert list(one.lidars) == list(whole.lidars) and list(one.tracks) == list(whole.tracks)
    kept, before = one.cameras[last], whole.cameras[last]
    assert kept.camera == before.camera
    np.testing.assert_array_equal(kept.timestamps_us, before.timestamps_us)
    # The world is the same, whichever cameras were taken.
    np.testing.assert_array_equal(one.world_from_rig.poses, whole.world_from_rig.poses)
    with pytest.raises(InputError) as raised:
        importer(tmp_path / "none", cameras=[last, "periscope"])
    assert raised.value.problem == "has no camera 'periscope'"
    assert raised.value.mend == f"choose one of {', '.join(whole.cameras)}"
    assert not (tmp_path / "none").exists()


def test_a_scenario_without_cameras_has_none_to_choose(shared: Path, tmp_path: Path) -> None:
    scenarios = shared / "data" / "waymo_v1"
    drive = "motion_data_one_scenario.tfrecord"
    with pytest.raises(InputError, match="has no camera 'FRONT'; leave the option out"):
        import_drive("waymo", scenarios, drive, tmp_path / "log", cameras=["FRONT"])


def test_files_of_other_cameras_need_not_be_there(tmp_path: Path) -> None:
    tiny_nuscenes.write_tiny_nuscenes(tmp_path)
    shutil.rmtree(tmp_path / "samples" / "CAM_FRONT")
    with pytest.raises(InputError, match="is missing under"):
        import_drive("nuscenes", tmp_path, tiny_nuscenes.SCENE, tmp_path / "log")
    with pytest.raises(InputError, match="has no camera 'CAM_BACK'; choose one of CAM_FRONT"):
        import_drive(
            "nuscenes", tmp_path, tiny_nuscenes.SCENE, tmp_path / "log", cameras=["CAM_BACK"]
        )


@pytest.mark.parametrize("name", WRITE)
@pytest.mark.parametrize(
    "drive", ["", "..", "../002", "/etc", "a\0b", "x" * 300, "a/b", "a\\b", "**/*", "[a"]
)
def test_a_drive_is_a_name_and_no_path(name: str, drive: str, tmp_path: Path) -> None:
    root = tmp_path / "root"
    WRITE[name][0](root)
    with pytest.raises(
        InputError, match=r"drive.*: (does not exist|has no file|is not a name)|drive"
    ) as raised:
        import_drive(name, root, drive, tmp_path / "log")
    assert "\n" not in str(raised.value)


def test_no_lidar_of_waymo_has_the_name_of_a_camera() -> None:
    lidars = {lidar_name(laser) for laser in LASER_NAME.names.values()}
    assert len(lidars) == 5 and not lidars & set(CAMERA_NAME.names.values())


def test_a_front_lidar_leaves_the_front_camera_where_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Mountings are stored by name: a LiDAR called FRONT overwrote that of the camera.
    monkeypatch.setattr(tiny_processed, "LASERS", {0: (1.43, 0.0, 2.18), 1: (4.0, 0.0, 0.7)})
    tiny_processed.write_drivestudio(tmp_path)
    import_drive("drivestudio", tmp_path, tiny_processed.SCENE, tmp_path / "log")
    log = read_log(tmp_path / "log")
    expected = tiny_processed.vehicle_from_waymo_camera(0)[:3, 3]
    np.testing.assert_allclose(log.cameras["FRONT"].rig_from_camera[:3, 3], expected, atol=1e-6)
    assert list(log.lidars) == ["lidar_top", "lidar_front"]
    np.testing.assert_allclose(
        log.lidars["lidar_front"].rig_from_lidar[:3, 3], (4, 0, 0.7), atol=1e-6
    )
