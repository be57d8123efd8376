"""Faulty nuScenes datasets: one line that names file, record and field, and nothing written."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from recast.core.errors import InputError
from support import tiny_nuscenes as tiny
from support.importing import import_drive

Damage = Callable[[Path], object]
KEY = f"samples/CAM_FRONT/n015__CAM_FRONT__{tiny.START_US}.jpg"
SWEEP = f"samples/LIDAR_TOP/n015__LIDAR_TOP__{tiny.START_US}.pcd.bin"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("nuscenes")
    tiny.write_tiny_nuscenes(root)
    return root


def _row(table: str, token: str, **changes: Any) -> Damage:
    """Change columns of a row, or remove those that become `...`."""

    def change(root: Path) -> None:
        rows = tiny.read_table(root / tiny.VERSION, table)
        row = next(row for row in rows if row["token"] == token)
        row.update(changes)
        for column in [column for column, value in changes.items() if value is ...]:
            del row[column]
        tiny.write_table(root / tiny.VERSION, table, rows)

    return change


def _cut(name: str) -> Damage:
    def change(root: Path) -> None:
        data = (root / name).read_bytes()
        (root / name).write_bytes(data[: len(data) // 2 + 1])

    return change


def _copied_row(table: str, source: str, **changes: Any) -> Damage:
    def change(root: Path) -> None:
        rows = tiny.read_table(root / tiny.VERSION, table)
        row = next(row for row in rows if row["token"] == source)
        tiny.write_table(root / tiny.VERSION, table, [*rows, row | changes])

    return change


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (
            lambda r: (r / tiny.VERSION / "ego_pose.json").unlink(),
            "ego_pose.json: table: is missing",
        ),
        (_cut("v1.0-mini/sample_data.json"), "sample_data.json: row "),
        (
            lambda r: (r / "v1.0-mini/sample.json").write_text('{"token": "a"}'),
            "sample.json: JSON: does not begin with a list",
        ),
        (
            lambda r: (r / "v1.0-mini/sample.json").write_text('["a"]'),
            "sample.json: row 0: is not an object",
        ),
        (
            _row("sample_data", "CAM_FRONT-0", timestamp=...),
            "sample_data.json: row 1 (token CAM_FRONT-0): timestamp: Field required",
        ),
        (
            _row("sample_data", "CAM_FRONT-0", sample_token=...),
            "sample_data.json: row 1: column sample_token is missing",
        ),
        (
            _row("ego_pose", "CAM_FRONT-0", translation=[0.0, float("nan"), 0.0]),
            "ego_pose.json: row 0 (token CAM_FRONT-0): translation.1: Input should be a finite",
        ),
        (
            _row("sample_data", "CAM_FRONT-0", ego_pose_token="gone"),
            "sample_data.json: token CAM_FRONT-0: ego_pose_token: 'gone' is not in ego_pose.json",
        ),
        (
            _row("sample_data", "LIDAR_TOP-50000", calibrated_sensor_token="gone"),
            "token LIDAR_TOP-50000: calibrated_sensor_token: 'gone' is not in",
        ),
        (
            _row("sample_annotation", "car2", instance_token="gone"),
            "sample_annotation.json: token car2: instance_token: 'gone' is not in instance.json",
        ),
        (
            _row("instance", "car", category_token="gone"),
            "instance.json: token car: category_token: 'gone' is not in category.json",
        ),
        (
            _row("category", "k-car", name="vehicle.hovercraft"),
            "category.json: token k-car: name: 'vehicle.hovercraft' is not a category of nuScenes",
        ),
        (
            _row("calibrated_sensor", "c-cam", camera_intrinsic=[]),
            "token c-cam: camera_intrinsic: is empty: a camera without calibration",
        ),
        (
            _row("calibrated_sensor", "c-cam", camera_intrinsic=[[1.0, 2.0], [3.0]]),
            "token c-cam: camera_intrinsic: is not a 3x3 matrix",
        ),
        (
            _row("calibrated_sensor", "c-lidar", rotation=[0.0, 0.0, 0.0, 2.0]),
            "token c-lidar: rotation: is not a rotation: the length of the quaternion is 2",
        ),
        (
            _row("ego_pose", "CAM_FRONT-83334", translation=[0.0, 0.0, 0.0]),
            "token CAM_FRONT-83334: translation: is 1171 m from the pose before: mixed",
        ),
        (
            _row("sample_annotation", "car3", translation=[15.0, 1.0, 0.7]),
            "sample_annotation.json: token car3: translation: the box is 1170 m from the ego",
        ),
        (
            _row("sample_annotation", "car3", size=[1.8, 0.0, 1.5]),
            "token car3: size: is (1.8, 0.0, 1.5), not a valid box size",
        ),
        (
            _copied_row("sample_annotation", "car3", token="again"),
            "token again: sample_token: instance car has a second box",
        ),
        (
            _copied_row("sample_data", "LIDAR_TOP-0", token="again"),
            "token again: timestamp: 1532402927000000 appears twice for LIDAR_TOP",
        ),
        (
            _row("sample", "key4", timestamp=tiny.START_US + 9_000_000),
            "sample.json: token key4: timestamp: 1532402936000000 lies outside",
        ),
        (
            _row("sample_data", "CAM_FRONT-0", width=32),
            "token CAM_FRONT-83334: width, height: are 64x48, but the camera's first image is",
        ),
        (
            _row("sample_data", "CAM_FRONT-0", filename="../../etc/passwd"),
            "token CAM_FRONT-0: filename: names '../../etc/passwd', which is not a file inside of",
        ),
        (
            _row("sample_data", "CAM_FRONT-0", timestamp=10**30),
            "(token CAM_FRONT-0): timestamp: Input should be",
        ),
        (
            _row("sample_data", "CAM_FRONT-0", width=10**9),
            "(token CAM_FRONT-0): width: Input should be less than",
        ),
        (
            _row("ego_pose", "CAM_FRONT-0", translation=[1e300, 0.0, 0.0]),
            "(token CAM_FRONT-0): translation.0: Input should be less than",
        ),
        (
            _row("sample_annotation", "car3", rotation=[1e200, 1e200, 0.0, 0.0]),
            "(token car3): rotation.0: Input should be less than",
        ),
        (
            _row("sample_annotation", "car3", size=[1.8, 1e6, 1.5]),
            "token car3: size: is (1.8, 1000000.0, 1.5), not a valid box size",
        ),
        (
            lambda r: (r / "v1.0-mini/sample.json").write_text("[" * 100_000),
            "sample.json: row 0: cannot be read (maximum recursion depth",
        ),
        (
            lambda r: (r / "v1.0-mini/sample.json").write_text('[{"a": ' + "1" * 5000 + "}]"),
            "sample.json: row 0: cannot be read (Exceeds the limit",
        ),
        (
            lambda r: (r / SWEEP).write_bytes(b"\xff\xff\x7f\x7f" * 5),
            f"{SWEEP}: point 0: is NaN or infinite, or not within 100000 m (3.4",
        ),
        (_row("sample_data", "LIDAR_TOP-0", fileformat="pkl"), "fileformat: is 'pkl', not pcd"),
        (lambda r: (r / KEY).unlink(), f"token CAM_FRONT-0: filename: {KEY} is missing under"),
        (_cut(KEY), f"{KEY}: image: cannot be decoded"),
        (lambda r: (r / SWEEP).write_bytes(b"\0" * 33), f"{SWEEP}: points: 33 bytes are not"),
        (lambda r: shutil.rmtree(r / tiny.VERSION), "v1.0-*: has no folder of tables"),
    ],
)
def test_a_faulty_dataset_is_one_clear_line(
    whole: Path, tmp_path: Path, damage: Damage, message: str
) -> None:
    root = tmp_path / "root"
    shutil.copytree(whole, root)
    damage(root)
    with pytest.raises(InputError) as raised:
        import_drive("nuscenes", root, tiny.SCENE, tmp_path / "out" / "log")
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []


def test_what_cannot_be_meant_is_refused_at_once(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="drive scene-7: does not exist; choose one of scene-0061"):
        import_drive("nuscenes", whole, "scene-7", tmp_path / "log")
    with pytest.raises(InputError, match="nuScenes folder: does not exist"):
        import_drive("nuscenes", whole / "nowhere", tiny.SCENE, tmp_path / "log")
    with pytest.raises(InputError, match="are already in the nuScenes tables"):
        import_drive(
            "nuscenes", whole, tiny.SCENE, tmp_path / "log", labels=tmp_path / "boxes.json"
        )
