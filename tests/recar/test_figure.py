from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from recast.recar import set_statistics
from recast.recar.figure import FIGURE_FILES, representatives, swatch, view_sheet, write_figure

from .sets import tree, write_set


def test_all_panels_are_drawn_and_the_same_every_time(tmp_path: Path) -> None:
    made = write_set(tmp_path / "set")
    for name in ("a", "b"):
        write_figure(made, set_statistics(made), tmp_path / name)
    assert sorted(tree(tmp_path / "a")) == sorted(FIGURE_FILES)
    assert tree(tmp_path / "a") == tree(tmp_path / "b")
    for name in FIGURE_FILES:
        image = cv2.imread(str(tmp_path / "a" / name))
        assert image is not None
        assert min(image.shape[:2]) > 250
        assert image.std() > 10


def test_the_sheet_shows_identities_in_rows_and_views_in_columns(tmp_path: Path) -> None:
    made = write_set(tmp_path)
    identities = list(made.identities.values())[:2]
    sheet = view_sheet(identities, [0, 2, 3])
    height, width = sheet.shape[0] // 2, sheet.shape[1] // 3
    assert width / height == pytest.approx(33 / 16, rel=0.1), "cut to the rectangle in all views"
    for row in range(2):
        for column, view in enumerate([0, 2, 3]):
            centre = sheet[height * row + height // 2, width * column + width // 2]
            assert np.array_equal(centre, [200, 40 * view, 10 * row])
    assert np.array_equal(sheet[2, 2], [245, 246, 248])


def test_every_kind_is_shown_before_any_twice(tmp_path: Path) -> None:
    made = write_set(tmp_path, 6)
    chosen = representatives(made, 3)
    assert [one.record.kind for one in chosen] == ["sedan", "van", "sedan"]
    assert len(representatives(made, 12)) == 6
    assert len({one.record.id for one in representatives(made, 12)}) == 6


def test_colours_are_drawn_in_themselves() -> None:
    white, black, red = swatch("white"), swatch("black"), swatch("red")
    assert white is not None and min(white) > 0.85
    assert black is not None and max(black) < 0.2
    assert red is not None and red[0] > 2 * max(red[1:])
    assert swatch("crimson") is not None, "names of CSS colours are known too"
    assert swatch("two-tone") is None
