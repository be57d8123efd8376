"""Margins and cosines, on vectors and through a tiny CLIP and a tiny CLIP-FlanT5."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.metrics.scene_level_images import (
    NEGATIVE,
    POSITIVE,
    VEHICLE,
    clip_image_score,
    clip_margin,
    clip_text_score,
    vqa_margin,
)
from recast.pretrained import Clip, load_vqa_scorer
from support.tiny_clip import write_clip, write_clip_t5

RNG = np.random.default_rng(0)
FRAMES = [RNG.integers(0, 256, (40, 60, 3), dtype=np.uint8) for _ in range(4)]


def test_prompts_are_the_papers() -> None:
    assert POSITIVE[0] == "A driving-camera image with realistic vehicles"
    assert NEGATIVE[2] == (
        "A driving-camera image with vehicles that have distorted shapes or fragmented geometry"
    )
    assert len({*POSITIVE, *NEGATIVE, VEHICLE}) == 7


def test_margins_by_hand() -> None:
    """Two frames at 0 and 90 degrees, prompts at 0, 60 and at 90, 180 degrees."""
    at = lambda *degrees: np.stack([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))], 1)  # noqa: E731
    margins = clip_margin(at(0, 90), at(0, 60), at(90, 180))
    sine = np.sqrt(3) / 2
    np.testing.assert_allclose(margins, [0.75 + 0.5, sine / 2 - 0.5], atol=1e-12)
    scores = np.array([[0.9, 0.5, 0.4]]), np.array([[0.2, 0.1, 0.3]])
    np.testing.assert_allclose(vqa_margin(*scores), [0.4])
    np.testing.assert_allclose(clip_text_score(at(0, 60), at(0)[0]), [100, 50])
    mean, most = clip_image_score(at(0, 90), at(0, 60))
    np.testing.assert_allclose(mean, [75, 50 * sine])
    np.testing.assert_allclose(most, [100, 100 * sine])


@given(st.integers(0, 999), st.integers(1, 5), st.integers(1, 4), st.integers(1, 4))
def test_exchanged_prompts_change_the_sign(seed: int, n: int, p: int, q: int) -> None:
    rng = np.random.default_rng(seed)
    frames, positive, negative = (rng.normal(size=(rows, 6)) for rows in (n, p, q))
    np.testing.assert_array_equal(
        clip_margin(frames, positive, negative), -clip_margin(frames, negative, positive)
    )


def test_through_the_networks(tmp_path: Path) -> None:
    write_clip(tmp_path / "clip")
    clip = Clip.read(tmp_path / "clip")
    seen = clip.images(FRAMES, "published")
    good, bad = clip.texts(POSITIVE), clip.texts(NEGATIVE)
    assert np.abs(clip_margin(seen, good, bad)).min() > 0
    np.testing.assert_array_equal(clip_margin(seen, good, bad), -clip_margin(seen, bad, good))
    crops = clip.images(FRAMES)
    # one picture on either side
    mean, most = clip_image_score(crops[:1], crops[:1])
    assert mean[0] == pytest.approx(100, abs=1e-9) and most[0] == mean[0]
    assert clip_image_score(crops, crops)[1] == pytest.approx(100, abs=1e-9)
    assert clip_image_score(crops, crops)[0].max() < 100 - 1e-6
    assert np.abs(clip_text_score(crops, clip.texts([VEHICLE])[0])).max() <= 100
    write_clip_t5(tmp_path / "t5")
    scorer = load_vqa_scorer(tmp_path / "t5")
    margin = vqa_margin(scorer.score(FRAMES, POSITIVE), scorer.score(FRAMES, NEGATIVE))
    exchanged = vqa_margin(scorer.score(FRAMES, NEGATIVE), scorer.score(FRAMES, POSITIVE))
    assert np.abs(margin).min() > 0
    np.testing.assert_array_equal(margin, -exchanged)
