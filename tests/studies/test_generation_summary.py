"""Tables and paired differences of a generation study from made-up cells."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.metrics.frechet import frechet_distance
from recast.studies.generation.cells import StudyCell, cell_is, read_cell, read_strip, write_cell
from recast.studies.generation.report import (
    StudyBlock,
    differences_table,
    study_json,
    study_markdown,
    study_table,
    summarize,
)

IDS = tuple(f"car-{index}" for index in range(12))
RNG = np.random.default_rng(0)
TRUE_FEATURES = {id: RNG.normal(size=(2, 3)).astype(np.float32) for id in IDS}


def truth() -> dict[str, StudyCell]:
    return {
        id: StudyCell("k", id, {}, ("a", "b"), features={"toy": TRUE_FEATURES[id]}) for id in IDS
    }


def cells(gain: float, off: float, fails_on: tuple[str, ...] = ()) -> list[StudyCell]:
    """PSNR rises with `gain`, features are `off` in every number; SSIM is the same for all."""
    made = []
    for index, id in enumerate(IDS):
        if id in fails_on:
            made.append(StudyCell("k", id, {}, failure="structure is empty"))
            continue
        scores = tuple(
            {"psnr": 20.0 + index + gain + view, "ssim": 0.5, "mask_iou": 0.9 - (index % 2) * gain}
            for view in (0.0, 1.0)
        )
        features = {"toy": TRUE_FEATURES[id] + np.float32(off)}
        made.append(StudyCell("k", id, {}, ("a", "b"), scores, features))
    return made


@pytest.fixture(scope="module")
def block() -> StudyBlock:
    models = {"base": cells(0.0, 0.5), "full": cells(2.0, 0.25), "third": cells(2.0, 0.25)}
    return summarize("clean", models, truth(), samples=500)


def test_means_and_distances(block: StudyBlock) -> None:
    base, full, _ = block.rows
    assert (base.model, base.made, block.views) == ("base", 12, 24)
    assert base.scores["psnr"] == pytest.approx(20 + 5.5 + 0.5)
    assert full.scores["psnr"] == pytest.approx(28.0)
    assert base.scores["toy"] == pytest.approx(0.5, rel=1e-5)
    assert base.scores["fd_toy"] == pytest.approx(3 * 0.5**2, rel=1e-4)  # moved, not widened
    expected = frechet_distance(
        np.concatenate([TRUE_FEATURES[id] + 0.25 for id in IDS]),
        np.concatenate([TRUE_FEATURES[id] for id in IDS]),
    )
    assert full.scores["fd_toy"] == pytest.approx(expected, rel=1e-4)
    assert list(base.scores) == ["psnr", "ssim", "mask_iou", "toy", "fd_toy"]


def test_paired_differences(block: StudyBlock) -> None:
    found = {(one.candidate, one.score): one for one in block.differences}
    assert {one.baseline for one in block.differences if one.candidate == "third"} == {"full"}
    gain = found["full", "psnr"]
    # vehicles differ by far more than the models: only pairs tell that every one gained two
    assert (gain.interval.low, gain.interval.high) == pytest.approx((2.0, 2.0))
    assert gain.better == "full"
    closer = found["full", "toy"]
    assert closer.interval.point == pytest.approx(-0.25, rel=1e-5)
    assert closer.better == "full"  # lower is better
    assert found["full", "mask_iou"].better == "base"
    assert found["full", "ssim"].better is None
    assert found["third", "psnr"].better is None
    assert ("full", "fd_toy") not in found


def test_intervals_widen_with_the_spread_between_vehicles() -> None:
    even = summarize("clean", {"a": cells(0, 0), "b": cells(1, 0)}, truth(), samples=500)
    uneven = [
        replace(one, scores=tuple(s | {"psnr": s["psnr"] + 3 * (i % 3)} for s in one.scores))
        for i, one in enumerate(cells(1, 0))
    ]
    spread = summarize("clean", {"a": cells(0, 0), "b": uneven}, truth(), samples=500)

    def width(one: StudyBlock) -> float:
        (psnr,) = [d.interval for d in one.differences if d.score == "psnr"]
        return psnr.high - psnr.low

    assert width(even) == pytest.approx(0.0, abs=1e-9)
    assert 2.0 < width(spread) < 4.0  # about 2 x 1.96 x 2.45 / sqrt(12)


def test_vehicles_that_one_model_failed_on_count_for_none() -> None:
    models = {"base": cells(0.0, 0.0, ("car-0", "car-3")), "full": cells(0.0, 0.0, ("car-11",))}
    block = summarize("perturbed", models, truth(), samples=100)
    assert len(block.identities) == 9
    assert [row.made for row in block.rows] == [10, 11]
    assert block.rows[0].scores["psnr"] == pytest.approx(block.rows[1].scores["psnr"])
    assert block.failures["full"] == {"car-11": "structure is empty"}
    with pytest.raises(ValueError, match="there is no vehicle that every model made"):
        summarize("clean", {"a": cells(0, 0, IDS), "b": cells(0, 0)}, truth())


def test_reports_say_what_was_found() -> None:
    failed = {"base": cells(0.0, 0.5), "full": cells(2.0, 0.25, ("car-4",))}
    blocks = [summarize(name, failed, truth(), samples=100) for name in ("clean", "perturbed")]
    facts = {
        "set": "cars",
        "placement": "canonical",
        "perturbations": {"rho_clean": 0.2},
        "samples": 100,
        "targets": "set",
        "beside": {},
    }
    text = study_markdown(facts, blocks)
    assert "## Perturbed inputs: 11 vehicles, 22 views" in text
    assert "| full | 11 | **28.14** | **0.5000** |" in text
    assert "| base | 12 | 26.14 |" in text
    assert "| full - base | PSNR dB ↑ | +2.000 | [+2.000, +2.000] | full |" in text
    assert "full did not make car-4: structure is empty" in text
    assert "the model's own forward axis" in text and "every input is perturbed" in text
    data = json.loads(json.dumps(study_json(facts, blocks), allow_nan=False))
    assert data["placement"] == "canonical"
    assert data["blocks"][1]["rows"][0]["scores"]["psnr"] == pytest.approx(26.136364)
    assert data["blocks"][0]["vehicles"]["car-2"]["full"]["psnr"] == pytest.approx(24.5)
    (difference, *_) = data["blocks"][0]["differences"]
    assert difference["score"] == "psnr" and difference["better"] == "full"
    assert study_table(blocks[0]).row_count == 2
    assert differences_table(blocks[0]).row_count == 4


def test_cells_come_back_and_go_stale(tmp_path: Path) -> None:
    folder = tmp_path / "cells" / "car-1"
    assert not cell_is(folder, "k")
    cell = cells(1.0, 0.0)[1]
    picture = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
    write_cell(folder, cell, {"strip": picture})
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    again = read_cell(folder)
    assert again.views == ("a", "b") and again.failure is None
    assert again.scores[1] == pytest.approx(cell.scores[1], abs=1e-6)
    np.testing.assert_array_equal(again.features["toy"], cell.features["toy"])
    np.testing.assert_array_equal(read_strip(folder), picture)
    assert cell_is(folder, "k") and not cell_is(folder, "other")
    write_cell(folder, cell, {"strip": picture})
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    (folder / "features.npz").write_bytes(b"PK cut short")
    with pytest.raises(InputError, match="delete it and run again"):
        read_cell(folder)
    with pytest.raises(InputError, match=r"other.png: file: is missing"):
        read_strip(folder, "other")
