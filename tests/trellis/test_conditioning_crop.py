"""Both crop rules against the published code, and where they part."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from PIL import Image

from recast.core.errors import InputError
from recast.trellis.conditioning import crop_to_object, object_box, read_crop, training_crop
from support.trellis import FOLDER, assert_same, golden_tensors


def _disc(centre: tuple[float, float] = (48.0, 48.0)):
    size, radius = 96, 30.0
    y, x = np.mgrid[:size, :size]
    inside = np.hypot(x - centre[0], y - centre[1]) < radius
    rgba = np.zeros((size, size, 4), np.uint8)
    rgba[inside] = (200, 90, 30, 255)
    return rgba


def test_inference_crop_is_the_published_one_to_the_bit():
    made_with = json.loads((FOLDER / "preprocess_boxes.json").read_text())["pillow"]
    if Image.__version__ != made_with:
        pytest.skip(f"made with Pillow {made_with}, this is {Image.__version__}")
    expected = np.array(Image.open(FOLDER / "preprocess_out_inference.png").convert("RGB"))
    found = crop_to_object(read_crop(FOLDER / "preprocess_in.png"), 518)
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, expected)


def test_inference_crop_with_any_pillow_is_within_one_level():
    expected = np.array(Image.open(FOLDER / "preprocess_out_inference.png").convert("RGB"))
    found = crop_to_object(read_crop(FOLDER / "preprocess_in.png"), 518)
    assert np.abs(found.astype(int) - expected.astype(int)).max() <= 1


def test_training_crop_is_the_published_one():
    golden = golden_tensors("preprocess")
    found = torch.from_numpy(training_crop(read_crop(FOLDER / "preprocess_in.png"), 518))
    assert_same(found[:, ::8, ::8], golden["train_cond_stride8"])
    assert_same(found.mean(), golden["train_cond_mean"])
    assert_same(found.std(), golden["train_cond_std"])


def test_boxes_of_both_rules():
    boxes = json.loads((FOLDER / "preprocess_boxes.json").read_text())
    alpha = read_crop(FOLDER / "preprocess_in.png")[..., 3]
    assert list(object_box(alpha)) == boxes["infer_bbox"]
    assert list(object_box(alpha, threshold=0)) == boxes["train_bbox"]


def test_a_faint_speck_shifts_the_trainers_crop_only():
    clean = _disc()
    speck = clean.copy()
    speck[2, 90] = (255, 255, 255, 40)
    np.testing.assert_array_equal(
        crop_to_object(speck, 64)[8:-8, 8:-8], crop_to_object(clean, 64)[8:-8, 8:-8]
    )
    assert np.abs(training_crop(speck, 64) - training_crop(clean, 64)).max() > 0.5


def test_object_fills_the_square_centred_on_black():
    crop = crop_to_object(_disc(centre=(40.0, 55.0)), 120)
    left, top, right, bottom = object_box(crop[..., 0], threshold=100)
    assert crop[0].max() == 0 and crop[:, 0].max() == 0
    assert abs((left + right) / 2 - 59.5) <= 1.5 and abs((top + bottom) / 2 - 59.5) <= 1.5
    assert right - left + 1 == pytest.approx(120 / 1.2, abs=5)


def test_square_may_leave_the_picture():
    """An object at the border stays centred; beyond the border all is black."""
    crop = crop_to_object(_disc(centre=(92.0, 48.0)), 64)
    assert crop[:, 60:].max() == 0
    assert crop[32, 30:34].min() > 20


def test_colours_under_transparent_pixels_do_not_bleed():
    dark = _disc()
    bright = dark.copy()
    bright[dark[..., 3] == 0] = (255, 255, 255, 0)
    np.testing.assert_array_equal(crop_to_object(dark, 50), crop_to_object(bright, 50))


def test_refused_crop_is_named():
    with pytest.raises(InputError, match=r"track 7: alpha: is zero everywhere"):
        crop_to_object(np.zeros((20, 20, 4), np.uint8), 32, where="track 7")


def test_real_vehicles_fill_the_crop(shared):
    """Every real picture of the set: 1/1.2 of the side, centred, and the mask's colours kept."""
    frames = sorted((shared / "data" / "vehicles").glob("*/*/frame_*.jpeg"))
    if not frames:
        pytest.skip("no real vehicles in the shared folder")
    for frame in frames:
        mask = Image.open(frame.with_name(frame.name.replace("frame", "mask")).with_suffix(".png"))
        rgba = np.dstack([np.array(Image.open(frame)), np.array(mask)])
        crop = crop_to_object(rgba, 128, where=frame)
        left, top, right, bottom = object_box(crop.max(axis=2), threshold=8)
        assert right - left + 1 == pytest.approx(128 / 1.2, abs=3), frame
        assert (left + right) / 2 == pytest.approx(63.5, abs=1.5), frame
        assert (top + bottom) / 2 == pytest.approx(63.5, abs=4), frame
