"""Image files: what was looked through once is not decoded again, unless it changed since."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recast.core.errors import InputError
from recast.logs import images
from recast.logs.images import ImageFiles


@pytest.fixture
def source(tmp_path: Path) -> ImageFiles:
    """Two images of 8 x 6 pixels."""
    rng = np.random.default_rng(0)
    paths = (tmp_path / "0.png", tmp_path / "1.png")
    for path in paths:
        Image.fromarray(rng.integers(0, 256, (6, 8, 3), dtype=np.uint8)).save(path)
    return ImageFiles(paths, 8, 6, "calib.txt")


def test_checked_files_are_not_decoded_again(
    source: ImageFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    source.check()
    monkeypatch.setattr(images, "decode", lambda *_: pytest.fail("decoded again"))
    for index, path in enumerate(source.paths):
        assert source.encoded(index) == (path.read_bytes(), "png")


@pytest.mark.parametrize("checked", [True, False])
def test_a_file_cut_off_is_refused_even_after_the_check(source: ImageFiles, checked: bool) -> None:
    if checked:
        source.check()
    path = source.paths[1]
    path.write_bytes(path.read_bytes()[:-40])
    source.encoded(0)
    with pytest.raises(InputError, match=r"1\.png"):
        source.encoded(1)


@pytest.mark.parametrize("channels", [3, 4])
def test_an_encoded_image_is_read_back(channels: int) -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (6, 8, channels), dtype=np.uint8)
    mode = {3: "RGB", 4: "RGBA"}[channels]
    png = images.encode(image)
    np.testing.assert_array_equal(images.decode(png, "png", (8, 6), "a.png", "a test", mode), image)
    flat = np.full((6, 8, channels), (200, 100, 40, 255)[:channels], np.uint8)
    jpeg = images.encode(flat, "jpeg", quality=95)
    found = images.decode(jpeg, "jpeg", (8, 6), "a.jpg", "a test")
    # One grey level of the quantised brightness and colours is at most 1.772 of a channel.
    assert np.abs(found.astype(int) - flat[..., :3]).max() <= 3
