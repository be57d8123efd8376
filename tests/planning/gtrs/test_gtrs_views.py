"""Stitching against reference images, the virtual rig, and the ego status."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from recast.cameras.mounts import camera_pose
from recast.core.errors import InputError
from recast.dynamics import make_state
from recast.geometry import se2, se3
from recast.planning import DrivingCommand
from recast.planning.gtrs import (
    NUPLAN_VIRTUAL,
    WAYMO_NATIVE,
    ViewLayout,
    ego_status,
    network_input,
    nuplan_rig,
)
from support.tiny_gtrs import GOLDEN, VIEWS


def _blocks(seed: int, height: int, width: int) -> np.ndarray:
    """Noise in squares of 40 pixels, as the reference images were made."""
    rows, columns = height // 40, width // 40
    small = np.random.RandomState(seed).randint(0, 256, (rows, columns, 3))
    y = np.minimum(np.arange(height) // 40, rows - 1)
    x = np.minimum(np.arange(width) // 40, columns - 1)
    return small.astype(np.uint8)[y[:, None], x]


@pytest.mark.parametrize(
    ("views", "seeds", "prefix", "stored"),
    [
        (NUPLAN_VIRTUAL, (1, 2, 3), "nuplan", "nuplan_stitched_resized_sub"),
        (WAYMO_NATIVE, (4, 5, 6), "waymo", "waymo_stitched_sub"),
    ],
)
def test_stitching_against_reference(
    views: ViewLayout, seeds: tuple[int, int, int], prefix: str, stored: str
) -> None:
    expected = np.load(GOLDEN / "gtrs_preprocess.npz")
    images = {
        name: _blocks(seed, views.height, views.width)
        for name, seed in zip(views.cameras, seeds, strict=True)
    }
    stitched = views.stitch(images)
    assert stitched.shape == (512, 2048, 3) == tuple(expected[f"{prefix}_shape"])
    np.testing.assert_array_equal(stitched[::8, ::8], expected[stored])
    np.testing.assert_allclose(stitched.mean((0, 1)), expected[f"{prefix}_mean"], atol=1e-9)


def test_network_input_is_rgb_in_unit_range() -> None:
    stitched = np.zeros((2, 3, 3), np.uint8)
    stitched[1, 2] = (255, 51, 0)
    tensor = network_input(stitched)
    assert tensor.shape == (3, 2, 3) and tensor.dtype == torch.float32
    torch.testing.assert_close(tensor[:, 1, 2], torch.tensor([1.0, 0.2, 0.0]))
    assert float(tensor.sum()) == pytest.approx(1.2)


def test_nothing_is_cropped_where_nothing_should_be() -> None:
    views = ViewLayout(
        width=8, height=6, crop_rows=0, crop_columns=0, input_width=24, input_height=6
    )
    images = {name: np.full((6, 8, 3), i, np.uint8) for i, name in enumerate(views.cameras)}
    assert views.stitch(images)[0, ::8, 0].tolist() == [0, 1, 2]


def test_bad_images_are_named() -> None:
    images = {name: np.zeros((32, 48, 3), np.uint8) for name in VIEWS.cameras}
    with pytest.raises(InputError, match=r"^planner x: camera front: .* there are front_left"):
        VIEWS.stitch({"front_left": images["front_left"]}, "planner x")
    for bad in (np.zeros((32, 47, 3), np.uint8), np.zeros((32, 48, 3), np.float32)):
        with pytest.raises(InputError, match=r"camera front_right: gives .*give \(32, 48, 3\)"):
            VIEWS.stitch(images | {"front_right": bad})


@pytest.mark.parametrize("size", [(480, 320), (1920, 1280), (240, 160), (300, 200)])
def test_other_sizes_in_proportion_see_the_same(size: tuple[int, int]) -> None:
    views = WAYMO_NATIVE.fitted(dict.fromkeys((*WAYMO_NATIVE.cameras, "rear"), size))
    scale = size[0] / 960
    assert (views.width, views.height, views.input_width, views.input_height) == (*size, 2048, 512)
    assert (views.crop_rows, views.crop_columns) == (round(64 * scale), round(208 * scale))
    small = {
        name: np.full((size[1], size[0], 3), 80 * i, np.uint8)
        for i, name in enumerate(views.cameras)
    }
    large = {name: np.full((640, 960, 3), 80 * i, np.uint8) for i, name in enumerate(views.cameras)}
    differs = (views.stitch(small) != WAYMO_NATIVE.stitch(large)).any(axis=(0, 2))
    assert differs.sum() <= 4 / scale + 8  # columns at the two seams, where pixels mix


def test_the_small_models_layout() -> None:
    mini = ViewLayout(
        width=480, height=320, crop_rows=32, crop_columns=104, input_width=1024, input_height=256
    )
    assert mini.fitted(dict.fromkeys(mini.cameras, (480, 320))) is mini
    twice = mini.fitted(dict.fromkeys(mini.cameras, (960, 640)))
    assert twice.model_dump() == WAYMO_NATIVE.model_dump() | {
        "input_width": 1024,
        "input_height": 256,
    }
    half = NUPLAN_VIRTUAL.fitted(dict.fromkeys(NUPLAN_VIRTUAL.cameras, (960, 540)))
    assert (half.crop_rows, half.crop_columns) == (14, 208)  # 544 + 960 + 544 columns, 512 rows


def test_other_proportions_and_mixed_sizes_are_refused() -> None:
    sizes = dict.fromkeys(WAYMO_NATIVE.cameras, (1242, 375))
    with pytest.raises(InputError, match=r"^planner x: camera front_left: renders 1242x375, but"):
        WAYMO_NATIVE.fitted(sizes, "planner x")
    sizes = dict.fromkeys(WAYMO_NATIVE.cameras, (960, 640)) | {"front": (480, 320)}
    with pytest.raises(InputError, match="camera front: renders 480x320"):
        WAYMO_NATIVE.fitted(sizes)
    with pytest.raises(InputError, match="camera front_left: is needed but missing"):
        WAYMO_NATIVE.fitted({"front": (960, 640)})


@pytest.mark.parametrize(
    "change", [{"crop_rows": 16}, {"crop_columns": -1}, {"cameras": ("a", "b", "a")}, {"width": 0}]
)
def test_impossible_layouts(change: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        ViewLayout(**(VIEWS.model_dump() | change))


def test_the_virtual_rig_is_nuplans() -> None:
    rig = nuplan_rig()
    assert tuple(rig) == NUPLAN_VIRTUAL.cameras
    for mount in rig.values():
        mount.camera.validate()
        assert (mount.camera.width, mount.camera.height) == (1920, 1080)
        rotation = mount.rig_from_camera[:3, :3]
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        field_of_view = 2 * np.arctan(mount.camera.width / 2 / mount.camera.fx)
        assert np.rad2deg(field_of_view) == pytest.approx(63.7, abs=0.05)
    left, front, right = (mount.rig_from_camera for mount in rig.values())
    assert left[1, 3] > 0.1 > front[1, 3] > right[1, 3]
    # A point 20 m ahead on the ground is seen below the front camera's centre, to the right of the
    # left camera's and to the left of the right camera's.
    point = np.array([[20.0, 0.0, 0.0]])
    seen = [se3.apply(se3.inverse(pose), point)[0] for pose in (left, front, right)]
    assert seen[1] == pytest.approx([0.04, 1.04, 18.36], abs=0.05)
    assert seen[0][0] > 5 and seen[2][0] < -5


@given(st.floats(-180, 180), st.floats(-80, 80))
def test_camera_pose_turns_the_axis_and_keeps_it_level(yaw: float, pitch: float) -> None:
    pose = camera_pose((1.0, 2.0, 3.0), yaw, pitch)
    axis, sideways, down = pose[:3, 2], pose[:3, 0], pose[:3, 1]
    turned = np.arctan2(axis[1], axis[0]) - np.deg2rad(yaw)
    assert float(se2.wrap_angle(turned)) == pytest.approx(0.0, abs=1e-9)
    assert np.arcsin(axis[2]) == pytest.approx(np.deg2rad(pitch), abs=1e-6)
    assert sideways[2] == pytest.approx(0.0) and down[2] < 0
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("command", "one_hot"),
    [
        (DrivingCommand.LEFT, [1, 0, 0, 0]),
        (DrivingCommand.STRAIGHT, [0, 1, 0, 0]),
        (DrivingCommand.RIGHT, [0, 0, 1, 0]),
        (DrivingCommand.UNKNOWN, [0, 0, 0, 1]),
    ],
)
def test_ego_status(command: DrivingCommand, one_hot: list[int]) -> None:
    state = make_state([100.0, -50.0, 2.0], speed=8.0, acceleration=-1.5, angular_velocity=0.25)
    status = ego_status(command, state)
    assert status.dtype == np.float32
    assert status.tolist() == [*one_hot, 8.0, 0.0, -1.5, 2.0]
