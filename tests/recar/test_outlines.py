"""Doubts about broken masks."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recast.recar.ingest import ingest_photographs
from recast.recar.ingest_photograph import outline_doubts
from recast.recar.ingest_table import IngestSettings
from support.vehicle_outlines import turntable_alphas

VIEWS = 24
NAMES = [f"{view}.png" for view in range(VIEWS)]


@pytest.fixture(scope="module")
def alphas() -> list[np.ndarray]:
    return turntable_alphas(np.arange(VIEWS) * 360 / VIEWS)


def without(alpha: np.ndarray, first: float, last: float) -> np.ndarray:
    """The mask without the columns between two shares of its width."""
    columns = np.flatnonzero(alpha.any(axis=0))
    left, right = np.quantile(columns, [first, last]).astype(int)
    broken = alpha.copy()
    broken[:, left : right + 1] = 0
    return broken


def test_whole_masks_raise_no_doubt(alphas: list[np.ndarray]) -> None:
    assert outline_doubts(alphas, NAMES) == ()
    for few in (1, 2, 3, 4, 8):
        assert outline_doubts(alphas[:: VIEWS // few][:few], NAMES) == ()


@pytest.mark.parametrize("part", [(0, 1 / 3), (1 / 3, 2 / 3), (2 / 3, 1)])
@pytest.mark.parametrize("view", [4, 6, 9, 18])
def test_a_third_of_a_side_missing_names_the_photograph(
    alphas: list[np.ndarray], view: int, part: tuple[float, float]
) -> None:
    broken = [*alphas[:view], without(alphas[view], *part), *alphas[view + 1 :]]
    (doubt,) = outline_doubts(broken, NAMES)
    assert doubt.startswith(f"{view}.png: the mask ")


@pytest.mark.parametrize("off", [-12.0, -3.5, 2.0, 7.5])
def test_a_front_that_is_off_raises_no_flood(off: float) -> None:
    turned = turntable_alphas(np.arange(VIEWS) * 360 / VIEWS + off)
    assert outline_doubts(turned, NAMES) == ()


def test_irregular_azimuths_raise_no_flood() -> None:
    jitter = np.random.default_rng(0).uniform(-5, 5, VIEWS)
    assert len(outline_doubts(turntable_alphas(np.arange(VIEWS) * 360 / VIEWS + jitter), NAMES)) < 2


def test_many_broken_masks_are_one_line(alphas: list[np.ndarray]) -> None:
    broken = [without(alpha, 0.3, 0.7) for alpha in alphas]
    (doubt,) = outline_doubts(broken, NAMES)
    assert doubt.startswith("24 of 24 masks have holes") and doubt.endswith("23.png")


def test_the_report_names_the_photograph(tmp_path: Path, alphas: list[np.ndarray]) -> None:
    folder = tmp_path / "photos" / "car"
    folder.mkdir(parents=True)
    (tmp_path / "photos" / "vehicles.csv").write_text("id,kind\ncar,sedan\n")
    rng = np.random.default_rng(0)
    for view, alpha in enumerate([*alphas[:6], without(alphas[6], 0, 1 / 3), *alphas[7:]]):
        grain = rng.integers(0, 255, (*alpha.shape, 3)).astype(np.uint8)
        Image.fromarray(np.dstack([grain, alpha])).save(folder / f"{view}.png")
    height, width = alphas[0].shape
    settings = IngestSettings("CC0-1.0", "test", VIEWS, width, height, duplicate_bits=0)
    ingest_photographs(tmp_path / "photos", tmp_path / "set", settings, None)
    (doubt,) = json.loads((tmp_path / "set" / "ingest.json").read_text())["doubts"]["car"]
    assert doubt.startswith("6.png: the mask differs from the mirrored mask of 18.png")
