from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from recast.core.errors import InputError
from recast.geometry import boxes, se3
from recast.recar.views import RealView, holds_real_crops, read_real_crops
from support.crops import DISTANCE, INPUTS, PIXELS, RESERVED, SIZE, direction, write_crops


@pytest.fixture
def crops(tmp_path: Path) -> Path:
    return write_crops(tmp_path / "crops")


def test_reads_views_and_turns_the_frame(crops: Path) -> None:
    (vehicle,) = read_real_crops(crops)
    assert vehicle.id == "car-a"
    np.testing.assert_allclose(vehicle.size, SIZE)
    assert (len(vehicle.inputs), len(vehicle.reserved)) == (1, 2)
    for view, where in zip(vehicle.inputs + vehicle.reserved, INPUTS + RESERVED, strict=True):
        eye = view.actor_from_camera[:3, 3]
        np.testing.assert_allclose(eye, DISTANCE * direction(*where), atol=1e-9)
        centre, depth = view.camera.project(se3.inverse(view.actor_from_camera)[:3, 3])
        np.testing.assert_allclose(centre, PIXELS / 2, atol=1e-6)  # it looks at the box centre
        assert depth == pytest.approx(DISTANCE)
        assert view.camera.fx == pytest.approx(PIXELS / 2 / np.tan(np.radians(15)))


def test_the_box_lies_on_the_mask_and_colours_on_their_ends(crops: Path) -> None:
    """A frame read the wrong way round puts the green nose where the red tail is."""
    (vehicle,) = read_real_crops(crops)
    for view in vehicle.inputs + vehicle.reserved:
        assert box_coverage(view, vehicle.size) > 0.6
        assert spill(view, vehicle.size) < 0.05
    front = vehicle.reserved[0]  # azimuth 40
    pixel, _ = front.camera.project(
        se3.apply(se3.inverse(front.actor_from_camera), np.array([[SIZE[0] / 2, 0.0, -0.35]]))
    )
    red, green, _, alpha = front.rgba()[int(pixel[0, 1]), int(pixel[0, 0])]
    assert alpha == 255
    assert green > 2 * red


def box_outline(view: RealView, size: np.ndarray) -> np.ndarray:
    corners, _ = view.camera.project(boxes.corners(size, se3.inverse(view.actor_from_camera)))
    outline = np.zeros((view.camera.height, view.camera.width), np.uint8)
    cv2.fillConvexPoly(outline, cv2.convexHull(corners.astype(np.float32)).astype(np.int32), 1)
    return outline > 0


def box_coverage(view: RealView, size: np.ndarray) -> float:
    outline, mask = box_outline(view, size), view.rgba()[..., 3] > 0
    return float((outline & mask).sum() / outline.sum())


def spill(view: RealView, size: np.ndarray) -> float:
    outline, mask = box_outline(view, size), view.rgba()[..., 3] > 0
    return float((mask & ~outline).sum() / mask.sum())


def test_one_vehicle_by_its_own_folder(crops: Path) -> None:
    assert holds_real_crops(crops) and holds_real_crops(crops / "car-a")
    assert not holds_real_crops(crops / "car-a" / "input_views")
    assert not holds_real_crops(crops / "nowhere")
    (vehicle,) = read_real_crops(crops / "car-a")
    assert vehicle.id == "car-a"


def record_change(field: str, value: object) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        record = json.loads((folder / "camera.json").read_text())
        if value is None:
            del record[field]
        else:
            record[field] = value
        (folder / "camera.json").write_text(json.dumps(record))

    return change


def no_mask(folder: Path) -> None:
    (folder / "mask_01.png").unlink()


def small_mask(folder: Path) -> None:
    cv2.imwrite(str(folder / "mask_01.png"), np.full((PIXELS, 20), 255, np.uint8))


def cut_short(folder: Path) -> None:
    path = folder / "frame_00.png"
    path.write_bytes(path.read_bytes()[:40])


def no_camera(folder: Path) -> None:
    (folder / "camera.json").unlink()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (record_change("cam_dists", [13.0]), r"cam_dists: has 1 entries for 2"),
        (record_change("mask_filenames", ["mask_00.png"] * 3), r"mask_filenames: has 3 entries"),
        (
            record_change("normalized_cam_positions", [[1, 0, 0], [1, 0, 0.5]]),
            r"normalized_cam_positions.1: has length 1.118",
        ),
        (record_change("cam_fovs", [0.0, 30.0]), r"cam_fovs.0: .*greater than 0"),
        (record_change("cam_fovs", [30.0, 180.0]), r"cam_fovs.1: .*less than 180"),
        (record_change("cam_dists", [13.0, -1.0]), r"cam_dists.1: .*greater than 0"),
        (record_change("cam_dists", [13.0, float("nan")]), r"JSON: .*NaN is not a number"),
        (record_change("object_lwh", [4.4, 0.0, 1.4]), r"object_lwh.1: .*greater than 0"),
        (record_change("object_lwh", [4.4, 1.9, 1.4]), r"object_lwh: is 4.400 x 1.900 x 1.400"),
        (record_change("frame_filenames", []), r"frame_filenames: "),
        (record_change("cam_fovs", None), r"cam_fovs: Field required"),
        (no_mask, r"mask_01.png: file: is missing"),
        (small_mask, r"mask_01.png: size: is 20x96, frame_01.png 96x96"),
        (cut_short, r"frame_00.png: image: cannot be decoded"),
        (no_camera, r"camera.json: file: is missing"),
    ],
)
def test_what_is_refused(crops: Path, change: Callable[[Path], None], message: str) -> None:
    change(crops / "car-a" / "reserved_views")
    with pytest.raises(InputError, match=message):
        read_real_crops(crops)


def test_an_empty_mask_and_an_empty_folder_are_refused(crops: Path, tmp_path: Path) -> None:
    path = crops / "car-a" / "input_views" / "mask_00.png"
    cv2.imwrite(str(path), np.zeros((PIXELS, PIXELS), np.uint8))
    (vehicle,) = read_real_crops(crops)
    with pytest.raises(InputError, match=r"mask_00.png: mask: is empty"):
        vehicle.inputs[0].rgba()
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no ID/input_views"):
        read_real_crops(tmp_path / "empty")
    with pytest.raises(InputError, match="is not a folder"):
        read_real_crops(tmp_path / "nowhere")


@pytest.mark.real_data
def test_real_boxes_lie_on_their_masks(shared: Path) -> None:
    vehicles = {one.id: one for one in read_real_crops(shared / "data" / "vehicles")}
    assert {name: len(one.reserved) for name, one in vehicles.items()} == {
        "382fee4aea8819ce": 3,
        "f32727777c346318": 1,
    }
    for vehicle in vehicles.values():
        for view in vehicle.inputs + vehicle.reserved:
            assert box_coverage(view, vehicle.size) > 0.5
            assert spill(view, vehicle.size) < 0.03
