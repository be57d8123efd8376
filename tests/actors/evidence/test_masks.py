from __future__ import annotations

import dataclasses

import numpy as np

from actors import made_up_evidence
from recast.actors.evidence import settle_masks
from recast.splats import Gaussians
from support import made_up_actors as made_up

AZIMUTHS = np.linspace(0, 2 * np.pi, 9)[:-1]


def test_masks_of_one_body_agree(red_car: Gaussians) -> None:
    views = made_up_evidence.sightings(red_car, AZIMUTHS)
    kept, refused = settle_masks(views, made_up.SIZE)
    assert len(kept) == len(views) and not refused
    for one in kept:
        mask = one.mask > 0.5
        # What is doubted is about the outline: cells of the hull are as wide as 1.3 pixels.
        assert (one.trust[mask] == 1).mean() > 0.8


def test_a_mask_of_something_else_is_refused(red_car: Gaussians) -> None:
    views = list(made_up_evidence.sightings(red_car, AZIMUTHS))
    wrong = np.zeros_like(views[2].mask)
    wrong[:12, :20] = 1
    views[2] = dataclasses.replace(views[2], mask=wrong)
    kept, refused = settle_masks(views, made_up.SIZE)
    assert [one.frame for one in refused] == [2]
    assert len(kept) == len(views) - 1


def test_what_one_mask_adds_is_doubted(red_car: Gaussians) -> None:
    views = list(made_up_evidence.sightings(red_car, AZIMUTHS))
    mask = views[4].mask.copy()
    rows, columns = np.nonzero(mask)
    below = slice(rows.max() + 1, rows.max() + 5)  # a shadow, say
    mask[below, columns.min() : columns.max()] = 1
    views[4] = dataclasses.replace(views[4], mask=mask)
    kept, _ = settle_masks(views, made_up.SIZE)
    assert kept[4].trust[below, columns.min() : columns.max()].mean() < 0.5
    np.testing.assert_array_equal(kept[4].mask, mask)
