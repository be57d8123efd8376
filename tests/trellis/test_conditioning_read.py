"""Pictures from disk: every way to hold alpha, and one clear line for each that holds no object."""

from __future__ import annotations

import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from recast.core.errors import InputError
from recast.trellis.conditioning import check_crop, read_crop


def _square(side: int = 20, picture: int = 32) -> np.ndarray:
    rgba = np.zeros((picture, picture, 4), np.uint8)
    rgba[4 : 4 + side, 4 : 4 + side] = (180, 60, 20, 255)
    return rgba


def _refusal(picture: np.ndarray) -> str:
    with pytest.raises(InputError) as caught:
        check_crop(picture, "car.png")
    line = str(caught.value)
    assert line.startswith("car.png: ") and "\n" not in line
    return line


def _unreadable(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_crop(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ") and "\n" not in line and line.count(str(path)) == 1
    return line


def test_eight_bit_rgba_comes_back_as_written(tmp_path: Path):
    Image.fromarray(_square()).save(tmp_path / "car.png")
    np.testing.assert_array_equal(read_crop(tmp_path / "car.png"), _square())


def test_sixteen_bit_rgba(tmp_path: Path):
    bgra = cv2.cvtColor(_square(), cv2.COLOR_RGBA2BGRA).astype(np.uint16) * 257
    cv2.imwrite(str(tmp_path / "car.png"), bgra)
    np.testing.assert_array_equal(read_crop(tmp_path / "car.png"), _square())


def test_palette_with_a_transparent_colour(tmp_path: Path):
    image = Image.fromarray(_square()[..., :3]).quantize(4)
    empty = image.getpixel((0, 0))
    image.save(tmp_path / "car.png", transparency=empty)
    np.testing.assert_array_equal(read_crop(tmp_path / "car.png"), _square())


def test_grey_with_alpha(tmp_path: Path):
    rgba = _square()
    Image.fromarray(rgba[..., [0, 3]], "LA").save(tmp_path / "car.png")
    np.testing.assert_array_equal(read_crop(tmp_path / "car.png"), rgba[..., [0, 0, 0, 3]])


def test_one_transparent_colour_of_an_rgb_png(tmp_path: Path):
    Image.fromarray(_square()[..., :3]).save(tmp_path / "car.png", transparency=(0, 0, 0))
    np.testing.assert_array_equal(read_crop(tmp_path / "car.png"), _square())


def test_stored_orientation_is_applied(tmp_path: Path):
    image = Image.fromarray(_square()[:, :28])
    exif = image.getexif()
    exif[0x0112] = 6
    image.save(tmp_path / "car.png", exif=exif)
    np.testing.assert_array_equal(read_crop(tmp_path / "car.png"), np.rot90(_square()[:, :28], -1))


def test_photograph_without_alpha(tmp_path: Path):
    Image.fromarray(_square()[..., :3]).save(tmp_path / "street.jpg")
    line = _unreadable(tmp_path / "street.jpg")
    assert "alpha: is absent" in line and "recast actor make" in line


def test_palette_without_alpha(tmp_path: Path):
    Image.fromarray(_square()[..., :3]).quantize(4).save(tmp_path / "street.png")
    assert "alpha: is absent" in _unreadable(tmp_path / "street.png")


def test_missing_file(tmp_path: Path):
    assert "file: is missing" in _unreadable(tmp_path / "none.png")


def test_no_picture(tmp_path: Path):
    (tmp_path / "car.png").write_text("no picture")
    assert "image: cannot be decoded (it is not one of BMP, JPEG, PNG" in _unreadable(
        tmp_path / "car.png"
    )


def test_folder_instead_of_a_file(tmp_path: Path):
    assert "file: is a folder" in _unreadable(tmp_path)


def test_picture_cut_short(tmp_path: Path):
    noise = np.random.default_rng(1).integers(0, 256, (64, 64, 4), np.uint8)
    Image.fromarray(noise).save(tmp_path / "car.png")
    data = (tmp_path / "car.png").read_bytes()
    (tmp_path / "car.png").write_bytes(data[: len(data) // 2])
    assert "image: cannot be decoded (it is cut short" in _unreadable(tmp_path / "car.png")


def test_picture_of_absurd_size(tmp_path: Path):
    Image.fromarray(_square()).save(tmp_path / "car.png")
    data = bytearray((tmp_path / "car.png").read_bytes())
    data[16:24] = (60_000).to_bytes(4, "big") * 2  # width and height
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    (tmp_path / "car.png").write_bytes(data)
    assert "size: is 60000x60000" in _unreadable(tmp_path / "car.png")


def test_array_without_alpha():
    assert "alpha: is absent (32x32x3 uint8)" in _refusal(_square()[..., :3])


def test_transparent_everywhere():
    assert "alpha: is zero everywhere" in _refusal(np.zeros((32, 32, 4), np.uint8))


def test_nothing_above_the_threshold():
    rgba = _square()
    rgba[..., 3] = rgba[..., 3] // 255 * 204
    assert "never exceeds 0.8 (largest 0.80)" in _refusal(rgba)


def test_opaque_everywhere():
    assert "is opaque everywhere" in _refusal(np.full((32, 32, 4), 255, np.uint8))


@pytest.mark.parametrize("side", [1, 3, 7])
def test_object_of_a_few_pixels(side: int):
    assert f"object: is {side}x{side} pixels" in _refusal(_square(side))


def test_object_just_large_enough():
    check_crop(_square(8), "car.png")


def test_no_pixels_at_all():
    assert "is zero everywhere" in _refusal(np.zeros((0, 0, 4), np.uint8))
