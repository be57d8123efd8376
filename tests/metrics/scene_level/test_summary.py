"""The table on made-up features, of which the right answers are known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.metrics.scene_level_images import (
    Features,
    LoggedFrame,
    Networks,
    RolloutFrame,
    SeenImage,
    image_scores,
    load_features,
    save_features,
)
from recast.metrics.scene_level_table import (
    LevelRow,
    MeasuredScene,
    summarise,
    table_markdown,
    warnings,
)
from support.tiny_clip import write_clip

IMAGES, WIDTH = 12, 8


def unit(rows: np.ndarray) -> np.ndarray:
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


TEXTS = unit(np.random.default_rng(99).normal(size=(7, WIDTH)))


def made_up(seed: int, shift: float = 0.0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        "drawn": np.ones(IMAGES, np.bool_),
        "frame_toy": rng.normal(shift, 1, (IMAGES, WIDTH)),
        "crop_toy": rng.normal(shift, 1, (IMAGES, WIDTH)),
        "frame_clip": unit(rng.normal(size=(IMAGES, WIDTH))),
        "frame_clip_padded": unit(rng.normal(size=(IMAGES, WIDTH))),
        "crop_clip": unit(rng.normal(size=(IMAGES, WIDTH))),
        "text_clip": TEXTS,
        "vqa": rng.uniform(size=(IMAGES, 6)),
        "lpips": rng.uniform(size=IMAGES),
    }


def scene(seed: int, arms: Mapping[str, Features]) -> MeasuredScene:
    frames = tuple(
        RolloutFrame("cut-in", "a", 5 * i, "front", (0, 0, 40, 40)) for i in range(IMAGES)
    )
    logged = tuple(LoggedFrame("front", i, i, (0, 0, 40, 40), 0.0) for i in range(IMAGES))
    references = made_up(1000 + seed)
    return MeasuredScene(frames, logged, (0, 3, 5), arms, references, references)


def scenes() -> dict[str, MeasuredScene]:
    return {
        f"s{n}": scene(n, {"native": made_up(n, 3.0), "other": made_up(100 + n, 0.5)})
        for n in range(3)
    }


def table(found: Mapping[str, MeasuredScene]) -> list[LevelRow]:
    return summarise(found, "log-replay", 500, 50, 0)


def test_the_baseline_comes_first_and_the_others_are_compared_with_it() -> None:
    native, other, control = table(scenes())
    assert (native.arm, native.images) == ("native", 3 * IMAGES)
    assert all(value.difference is None for value in native.values.values())
    assert all(value.difference is None for value in control.values.values())
    for name, value in other.values.items():
        assert value.difference is not None
        point, low, high = value.difference
        assert low <= high
        assert point == pytest.approx(value.value - native.values[name].value, abs=1e-9)
    assert other.values["fd_crop_toy"].value < native.values["fd_crop_toy"].value
    # What is drawn just as it was recorded is at no distance from it.
    assert control.values["fd_scene_toy"].value == pytest.approx(0.0, abs=1e-6)


def test_equal_images_have_the_best_scores() -> None:
    crop = unit(np.ones(WIDTH))
    same = {**made_up(0), "crop_clip": np.tile(crop, (IMAGES, 1)), "lpips": np.zeros(IMAGES)}
    scores = image_scores(same, same, np.arange(3))
    assert scores["clip_img"] == pytest.approx(np.full(IMAGES, 100.0))
    assert scores["clip_img_max"] == pytest.approx(np.full(IMAGES, 100.0))
    assert not scores["lpips"].any()


def test_exchanged_prompts_change_the_sign() -> None:
    given = made_up(0)
    order = [3, 4, 5, 0, 1, 2]
    exchanged = {**given, "text_clip": TEXTS[[*order, 6]], "vqa": given["vqa"][:, order]}
    one, other = (image_scores(f, given, np.arange(3)) for f in (given, exchanged))
    for name in ("clip_margin", "clip_margin_padded", "vqa_margin"):
        assert one[name] == pytest.approx(-other[name], abs=1e-9)
        assert np.abs(one[name]).max() > 1.0
    assert one["clip_veh"] == pytest.approx(other["clip_veh"])


def test_the_order_of_arms_changes_no_number() -> None:
    given = scenes()
    turned = {
        name: replace(one, arms=dict(reversed(list(one.arms.items()))))
        for name, one in given.items()
    }
    one = {row.arm: row for row in table(given)}
    other = {row.arm: row for row in table(turned)}
    for arm in ("native", "other"):
        for name, value in one[arm].values.items():
            assert (value.value, value.low, value.high) == (
                other[arm].values[name].value,
                other[arm].values[name].low,
                other[arm].values[name].high,
            )


def test_an_image_that_fails_for_one_arm_leaves_all() -> None:
    given = scenes()
    broken = dict(made_up(0, 3.0))
    broken["drawn"] = broken["drawn"].copy()
    broken["drawn"][4] = False
    for name in ("frame_toy", "crop_toy", "frame_clip", "crop_clip", "lpips", "vqa"):
        broken[name] = broken[name].copy()
        broken[name][4] = np.nan
    broken["frame_clip_padded"] = broken["frame_clip_padded"].copy()
    broken["frame_clip_padded"][4] = np.nan
    given["s0"] = replace(given["s0"], arms={**given["s0"].arms, "native": broken})
    native, other, control = table(given)
    assert native.images == other.images == 3 * IMAGES - 1
    assert control.images == 3 * IMAGES
    assert all(np.isfinite(value.value) for row in (native, other) for value in row.values.values())


def test_scenes_that_cannot_count_say_why() -> None:
    one = scenes()["s0"]
    assert one.problem() is None
    assert "drives" in str(replace(one, frames=()).problem())
    assert "logged" in str(replace(one, logged=()).problem())
    unseen = {**made_up(0), "drawn": np.zeros(IMAGES, np.bool_)}
    assert "rendered" in str(replace(one, arms={"native": unseen}).problem())
    fewer = {"native": {name: array[:5] for name, array in made_up(0).items()}}
    assert "different images" in str(replace(one, arms=fewer).problem())
    with pytest.raises(InputError, match="none could be measured"):
        table({})


def test_the_markdown_has_every_arm_and_the_paper_s() -> None:
    rows = table(scenes())
    notes = warnings(rows, scenes())
    assert notes == []  # 36 images, 8 features
    text = table_markdown(rows, ["a note"])
    assert "| native | 36 |" in text and "paper: omnire+TRELLIS" in text and "- a note" in text
    assert "-294.91" in text  # VQA margin of streetgs, which has a column here
    widths = {line.count("|") for line in text.splitlines() if line.startswith("|")}
    assert len(widths) == 1


def test_features_come_back_and_damage_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "features.npz"
    given = made_up(0)
    save_features(given, path)
    found = load_features(path)
    assert all(np.array_equal(found[name], value) for name, value in given.items())
    data = path.read_bytes()
    save_features(given, tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == data
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="cannot be read"):
        load_features(path)
    save_features({**given, "lpips": np.zeros(3)}, path)
    with pytest.raises(InputError, match="lpips: has 3 rows, expected 12"):
        load_features(path)
    with pytest.raises(InputError, match="is missing"):
        load_features(tmp_path / "none.npz")


def test_the_networks_that_are_given_have_arrays(tmp_path: Path) -> None:
    write_clip(tmp_path)
    rng = np.random.default_rng(0)
    seen = SeenImage(rng.integers(0, 256, (40, 60, 3), dtype=np.uint8), (0, 10, 30, 30))
    found = Networks(clip=tmp_path).look([seen, None, seen], [])
    assert {"frame_clip", "frame_clip_padded", "crop_clip", "text_clip"} <= found.keys()
    assert np.asarray(found["text_clip"]).shape == (7, 8)
    lengths = np.linalg.norm(np.asarray(found["crop_clip"], np.float64), axis=1)
    assert lengths == pytest.approx([1.0, np.nan, 1.0], abs=1e-6, nan_ok=True)
    scores = image_scores(found, found, np.array([0]))
    assert scores["clip_img"][0] == pytest.approx(100.0)  # its own crop is the reference


def test_images_that_are_not_drawn_are_rows_of_nan() -> None:
    rng = np.random.default_rng(0)
    seen = [
        SeenImage(rng.integers(0, 256, (40, 60, 3), dtype=np.uint8), (10, 10, 30, 30))
        for _ in range(20)
    ]
    whole = Networks().look(seen, [])
    gaps = Networks().look([seen[0], None, *seen[1:]], [])
    assert gaps["drawn"].tolist() == [True, False, *[True] * 19]
    assert np.isnan(gaps["crop_toy"][1]).all()
    assert np.array_equal(np.delete(gaps["crop_toy"], 1, axis=0), whole["crop_toy"])
    assert not np.array_equal(whole["frame_toy"], whole["crop_toy"])
