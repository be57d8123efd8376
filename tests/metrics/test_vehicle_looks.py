"""Paint, sharpness and structure on a ladder of distortions."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from recast.arrays import Array
from recast.metrics.actor_scores import ScoredCutout
from recast.metrics.oracle_scores import (
    fine_energy_share,
    light_gain,
    paint_distance,
    sharpness,
    structure_distance,
)


def vehicle() -> ScoredCutout:
    """A textured body with panes, wheels and a lamp, 180 pixels long."""
    rng = np.random.default_rng(0)
    rgb, alpha = np.zeros((140, 220, 3)), np.zeros((140, 220))
    for rows, columns, colour in (
        ((40, 105), (20, 200), (0.6, 0.2, 0.15)),
        ((46, 66), (60, 110), (0.1, 0.12, 0.15)),
        ((46, 66), (116, 170), (0.1, 0.12, 0.15)),
        ((72, 82), (22, 36), (0.95, 0.9, 0.8)),
        ((92, 115), (45, 68), (0.05, 0.05, 0.05)),
        ((92, 115), (150, 173), (0.05, 0.05, 0.05)),
    ):
        rgb[slice(*rows), slice(*columns)], alpha[slice(*rows), slice(*columns)] = colour, 1.0
    grain = cv2.GaussianBlur(rng.normal(0, 0.15, alpha.shape), (0, 0), 1.2)
    return ScoredCutout(np.clip(rgb + grain[..., None] * alpha[..., None], 0, 1), alpha)


def blurred(cutout: ScoredCutout, width: float) -> ScoredCutout:
    rgb, alpha = (cv2.GaussianBlur(one, (0, 0), width) for one in (cutout.rgb, cutout.alpha))
    return ScoredCutout(np.asarray(rgb, np.float64), np.asarray(alpha, np.float64))


def ghost(cutout: ScoredCutout, pixels: int) -> ScoredCutout:
    twice = 0.5 * (cutout.rgb + np.roll(cutout.rgb, pixels, axis=1))
    return ScoredCutout(twice * cutout.alpha[..., None], cutout.alpha)


def test_sharpness_is_what_is_left_of_the_fine_energy() -> None:
    truth = vehicle()
    shares = [sharpness(blurred(truth, width), truth) for width in (0.3, 1.0, 2.0, 6.0)]
    assert sharpness(truth, truth) == pytest.approx(1.0)
    assert shares == sorted(shares, reverse=True) and shares[0] > 0.8 and shares[-1] < 0.15
    assert fine_energy_share(truth.rgb, truth.rgb, np.zeros(truth.alpha.shape, bool)) == 0.0


def test_structure_orders_the_ladder() -> None:
    truth = vehicle()
    other = ScoredCutout(truth.rgb[::-1], truth.alpha[::-1])  # another body
    flat = ScoredCutout(truth.alpha[..., None] * [0.5, 0.2, 0.15], truth.alpha)
    tinted = ScoredCutout(truth.rgb * [0.4, 1.0, 1.0], truth.alpha)
    ladder = [truth, blurred(truth, 0.7), blurred(truth, 3.0), flat]
    apart = [structure_distance(one, truth) for one in ladder]
    assert apart[0] == 0.0 and apart == sorted(apart)
    assert apart[1] < structure_distance(ghost(truth, 12), truth)
    for worse in (other, tinted):
        assert structure_distance(worse, truth) > apart[1]


def test_paint_under_the_light_of_the_input() -> None:
    mask = np.zeros((40, 60), bool)
    mask[10:20, 20:40] = True
    bright = np.full((40, 60, 3), 0.6)
    dark: Array = bright * 0.8
    gain = light_gain(bright, mask, dark, mask)
    assert gain == pytest.approx([1.65] * 3, abs=0.1)  # linear light of display values
    grey = np.array([53.6, 0.0, 0.0])  # display value 0.5
    lit = np.array([65.0, 0.0, 0.0])
    assert paint_distance(grey, grey, np.ones(3)) == pytest.approx(0.0, abs=0.1)
    assert paint_distance(lit, grey, gain) < 3 < paint_distance(lit, grey, np.ones(3))
    # night is not another exposure, and a cut-out has no floor
    assert light_gain(bright, mask, bright * 0.2, mask) == pytest.approx(np.ones(3))
    assert light_gain(bright * 0, mask, bright * 0, mask) == pytest.approx(np.ones(3))
