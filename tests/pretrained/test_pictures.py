"""Squares about rectangles, and pictures as networks are given them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from transformers import CLIPImageProcessor

from recast.pretrained import (
    mean_colour,
    network_input,
    padded_square,
    resized,
    square_crop,
    whole_picture,
)

COLOUR = np.array([122, 116, 104], np.uint8)
PROCESSOR = CLIPImageProcessor(
    size={"shortest_edge": 224}, crop_size={"height": 224, "width": 224}
)  # as openai/clip-vit-large-patch14
HEIGHT, WIDTH = 40, 60
edges = st.floats(-30, 90, allow_nan=False)


def numbered() -> np.ndarray:
    """An image whose pixels tell their row and column, and are unlike the colour."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return np.dstack([rows, columns, np.full_like(rows, 255)]).astype(np.uint8)


@given(edges, edges, st.floats(0.5, 80), st.floats(0.5, 80), st.floats(0, 0.5))
@settings(max_examples=300, deadline=None)
def test_a_target_at_the_edge_is_wholly_in_its_crop(
    left: float, top: float, width: float, height: float, grow: float
) -> None:
    crop = square_crop(numbered(), (left, top, left + width, top + height), COLOUR, grow)
    side = len(crop)
    assert crop.shape == (side, side, 3)
    grown = (1 + 2 * grow) * max(width, height)
    assert grown - 1e-9 <= side <= grown + 2  # rounded outwards on either side
    shown = crop[..., 2] == 255
    if shown.any():  # every pixel in its place: one shift for all
        down, right = np.argwhere(shown)[0] - crop[tuple(np.argwhere(shown)[0])][:2]
        rows, columns = np.nonzero(shown)
        np.testing.assert_array_equal(crop[shown, 0], rows - down)
        np.testing.assert_array_equal(crop[shown, 1], columns - right)
    # every pixel of the image that the rectangle touches is there
    seen = {(int(row), int(column)) for row, column, _ in crop[shown]}
    rows, columns = (
        range(max(int(np.floor(low)), 0), min(int(np.ceil(high)), size))
        for low, high, size in ((top, top + height, HEIGHT), (left, left + width, WIDTH))
    )
    assert {(row, column) for row in rows for column in columns} <= seen
    assert (crop[~shown] == COLOUR).all()


def test_a_crop_by_hand() -> None:
    """A rectangle of 10 x 4 about (4, 20): a square of 12 from column -2 and row 14 on."""
    image = numbered()
    crop = square_crop(image, (-1, 18, 9, 22), COLOUR)
    assert crop.shape == (12, 12, 3)
    assert (crop[:, :2] == COLOUR).all()
    np.testing.assert_array_equal(crop[:, 2:], image[14:26, :10])
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[18:22, :9] = True
    masked = square_crop(image, (-1, 18, 9, 22), COLOUR, mask=mask)
    np.testing.assert_array_equal(masked[4:8, 2:11], image[18:22, :9])
    masked[4:8, 2:11] = COLOUR
    assert (masked == COLOUR).all() and image[0, 0, 2] == 255  # the image itself is not touched


@pytest.mark.parametrize(
    "rectangle", [(3, 3, 3, 9), (9, 3, 3, 9), (0, 0, np.nan, 4), (0, 0, np.inf, 4), (0, 0, 9e3, 4)]
)
def test_rectangles_that_are_refused(rectangle: tuple[float, float, float, float]) -> None:
    with pytest.raises(ValueError, match="square_crop: rectangle"):
        square_crop(numbered(), rectangle, COLOUR)


def test_frames_as_clip_is_given_them() -> None:
    """A frame of 3 : 2, its left and right sixths red: the published processor cuts them off."""
    frame = np.full((640, 960, 3), (0, 255, 0), np.uint8)
    frame[:, :160] = frame[:, -160:] = (255, 0, 0)
    assert (mean_colour(PROCESSOR) == COLOUR).all()
    seen = {}
    for fit in ("published", "whole", "padded"):
        pixels = network_input(PROCESSOR, [frame, frame[:, :640]], fit).numpy()
        assert pixels.shape == (2, 3, 224, 224) and pixels.dtype == np.float32
        scale, shift = (
            np.array(v)[:, None, None] for v in (PROCESSOR.image_std, PROCESSOR.image_mean)
        )
        seen[fit] = pixels[0] * scale + shift
    red = {fit: (one[0] > 0.5) & (one[1] < 0.3) for fit, one in seen.items()}
    assert not red["published"][:, 2:-2].any()  # a pixel or two of bicubic blur
    for fit in ("whole", "padded"):
        assert 73 <= red[fit][112].sum() <= 76  # 2 x 160 / 960 x 224 = 74.7
    assert red["whole"][0, 0] and red["whole"][-1, -1]
    # 224 / 3 / 2 = 37.3 rows above and below hold the mean colour, which is about zero
    above = np.abs(seen["padded"][:, :36] - COLOUR[:, None, None] / 255)
    assert above.max() < 1e-6 and not red["padded"][:36].any() and red["padded"][39, 0]


def test_uint8_and_floats_are_one_picture() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (50, 70, 3), dtype=np.uint8)
    np.testing.assert_array_equal(
        whole_picture(PROCESSOR, picture / 255), network_input(PROCESSOR, [picture], "whole")
    )
    for antialias in (False, True):
        one, other = (resized([p], 32, antialias).numpy() for p in (picture, picture / 255))
        np.testing.assert_allclose(one, other, atol=1e-6)
        assert one.shape == (1, 3, 32, 32) and 0 <= one.min() < one.max() <= 1
    same = resized([picture[:40, :40]], 40, antialias=True)[0].movedim(0, -1).numpy()
    np.testing.assert_allclose(same, picture[:40, :40] / 255, atol=1e-6)


def test_antialiasing_averages_what_shrinks() -> None:
    """Columns of white and black, seven to a pixel: means of many against two of them."""
    stripes = np.zeros((224, 224, 3), np.uint8)
    stripes[:, ::2] = 255
    fine, coarse = (resized([stripes], 32, antialias).numpy() for antialias in (True, False))
    assert np.abs(fine - 0.5).max() < 0.1 < 0.4 < np.abs(coarse - 0.5).max()


def test_padded_squares() -> None:
    image = numbered()
    square = padded_square(image, COLOUR)
    assert square.shape == (60, 60, 3)
    np.testing.assert_array_equal(square[10:50], image)
    assert (square[:10] == COLOUR).all() and (square[50:] == COLOUR).all()
    odd = padded_square(image[:, :39], COLOUR)
    np.testing.assert_array_equal(odd[:, :39], image[:, :39])  # the odd pixel is on the right
