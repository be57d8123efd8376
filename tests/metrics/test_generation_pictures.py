"""Tiles and sheets of a generation study."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.metrics.actor_scores import ScoredCutout, photographed
from recast.studies.sheets import (
    TILE,
    SheetRow,
    applied_caption,
    pages,
    sheet,
    strip,
    tile,
    tile_window,
)
from support.crops import photograph, two_coloured_box

VEHICLE = photographed(photograph(two_coloured_box(), 130.0, 10.0))
WINDOW = tile_window(VEHICLE.mask)


@given(st.integers(0, 30), st.integers(0, 40), st.integers(1, 9), st.integers(1, 30))
def test_windows_hold_their_mask_in_the_shape_of_a_tile(
    top: int, left: int, height: int, width: int
) -> None:
    mask = np.zeros((40, 50), bool)
    mask[top : top + height, left : left + width] = True
    rows, columns = np.nonzero(mask)
    window = tile_window(mask)
    high, wide = window.height, window.width
    assert window.left <= columns.min() and window.left + wide >= columns.max() + 1
    assert window.top <= rows.min() and window.top + high >= rows.max() + 1
    assert abs(wide / high - TILE[0] / TILE[1]) < 1.0 / high + 0.05 * wide / high


def test_tiles_reach_beyond_the_image() -> None:
    alpha = np.ones((20, 30))
    white = ScoredCutout(np.ones((20, 30, 3)), alpha)
    shown = tile(white, tile_window(white.mask))
    assert shown.shape == (TILE[1], TILE[0], 3)
    assert shown[TILE[1] // 2, TILE[0] // 2].min() == 255
    assert shown[0, 0].tolist() == [140] * 3  # grey where there is no picture
    empty = ScoredCutout(np.zeros((20, 30, 3)), np.zeros((20, 30)))
    assert np.ptp(tile(empty, tile_window(empty.mask))) == 0


def test_a_sheet_has_a_row_for_each_vehicle_and_a_block_for_each_model() -> None:
    views = strip([VEHICLE] * 4, [WINDOW] * 4)
    assert views.shape == (TILE[1], 4 * TILE[0], 3)
    source = tile(VEHICLE, WINDOW)
    page = sheet("input", ["a", "b"], [SheetRow("car", source, [views, None], views)] * 2)
    width, row = 4 * TILE[0] + 12, TILE[1] + 14
    assert page.shape == (26 + 2 * row, TILE[0] + 3 * width, 3)
    block = slice(26, 26 + TILE[1])
    np.testing.assert_array_equal(page[block, : TILE[0]], source)
    first = TILE[0] + 12
    np.testing.assert_array_equal(page[block, first : first + 4 * TILE[0]], views)
    missing = page[block, first + width : first + width + 4 * TILE[0]]
    assert 0 < (missing < 255).mean() < 0.05  # nothing but a word
    np.testing.assert_array_equal(page[26 : 26 + row], page[26 + row :])


@pytest.mark.parametrize(("rows", "sizes"), [(1, [1]), (10, [10]), (11, [6, 5]), (25, [9, 9, 7])])
def test_pages_are_even(rows: int, sizes: list[int]) -> None:
    one = SheetRow("car", tile(VEHICLE, WINDOW), [], tile(VEHICLE, WINDOW))
    assert [len(page) for page in pages([one] * rows)] == sizes
    assert pages([]) == []


def test_captions_tell_what_befell_the_input() -> None:
    assert applied_caption("car-1", []) == "car-1"
    applied = [{"name": "fog", "severity": 0.25}, {"name": "holes", "severity": 1.0}]
    assert applied_caption("car-1", applied) == "car-1: fog 0.2, holes 1.0"
