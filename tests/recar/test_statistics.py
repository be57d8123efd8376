from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from recast.recar import set_statistics, statistics_table
from support.vehicle_sets import VIEWS, write_set


def test_the_numbers_of_a_small_set(tmp_path: Path) -> None:
    made = write_set(tmp_path)
    found = set_statistics(made)
    assert (found.identities, found.pictures) == (3, 3 * VIEWS)
    assert found.splits == {"train": 2, "held-out": 1}
    assert list(found.kinds.items()) == [("sedan", 2), ("van", 1)]
    assert list(found.colours.items()) == [("white", 2), ("red", 1)]
    assert found.sizes is not None
    assert found.sizes[0] == pytest.approx((4.5, 1.8, 1.5))
    assert found.sizes[1][0] == pytest.approx(4.6)
    assert found.sizes[2][0] == pytest.approx(4.7)
    assert found.bytes == sum(p.stat().st_size for p in tmp_path.rglob("*.png"))


def test_the_table_says_it_in_words(tmp_path: Path) -> None:
    made = write_set(tmp_path)
    printer = Console(width=100, record=True, file=io.StringIO())
    printer.print(statistics_table(made, set_statistics(made)))
    text = printer.export_text()
    assert "2 train, 1 held out" in text
    assert "4 per identity, 48x32, 12 images" in text
    assert "sedan" in text
    assert "66.7 %" in text
    assert "4.60 m median, 4.50 to 4.70" in text
