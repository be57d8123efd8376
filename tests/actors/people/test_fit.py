"""Builds, gaits and clothes are found again in images of people who have them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from actors.people import made_up_people as made_up
from recast.actors.people.body import PersonShape, Region, surface_of
from recast.actors.people.clothes import dress
from recast.actors.people.fit import fit_person
from recast.actors.people.views import box_from_body


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        (made_up.WALKER, made_up.BOX),
        (replace(made_up.WALKER, girth=0.9, pack=True, cycle=1.45), made_up.BOX),
        (made_up.RIDER, made_up.RIDER_BOX),
    ],
)
def test_a_known_body_is_found(shape: PersonShape, size: np.ndarray) -> None:
    seen = made_up.views(shape, size)
    told: list[tuple[int, int]] = []
    fit, cut = fit_person(seen, size, bool(shape.bicycle), lambda *both: told.append(both))
    assert fit.shape.cycle == pytest.approx(shape.cycle, rel=0.06)
    middle = np.mean([view.gone for view in seen])
    off = fit.phase + middle / fit.shape.cycle - made_up.PHASE - middle / shape.cycle
    # Half a cycle on, the legs have changed places: outlines from the side are alike.
    assert abs((off + 0.25) % 0.5 - 0.25) < 0.06
    assert fit.shape.pack == shape.pack
    assert fit.shape.height == pytest.approx(shape.height, rel=0.05)
    overlaps = [
        (one.mask * other.mask).sum() / np.maximum(one.mask, other.mask).sum()
        for one, other in zip(seen, cut, strict=True)
    ]
    assert np.mean(overlaps) > 0.75
    assert told == [(1, 2)]


def test_one_image_keeps_the_habit() -> None:
    view = made_up.views(made_up.WALKER, made_up.BOX)[3]
    fit, _ = fit_person([view], made_up.BOX, False)
    assert fit.shape.cycle == pytest.approx(0.8 * made_up.WALKER.height, rel=0.05)


def test_clothes_are_those_of_the_images() -> None:
    seen = made_up.views(made_up.WALKER, made_up.BOX)[3:7]
    surface = surface_of(made_up.WALKER, 0.03)
    gaussians, gait = made_up.body(made_up.WALKER, made_up.BOX)
    posed = [gait.posed(gaussians, made_up.PHASE + one.gone / gait.cycle) for one in seen]
    clothes = dress(surface, posed, seen)
    for region in (Region.TOP, Region.TROUSERS):
        worn = np.median(clothes.colours[surface.region == region], axis=0)
        np.testing.assert_allclose(worn, made_up.COLOURS[region], atol=0.06)
    assert clothes.shares.fault(len(surface.points)) is None
    # From ahead: backs are never seen.
    back = (surface.normals[:, 0] < -0.9) & (surface.region == Region.TOP)
    front = (surface.normals[:, 0] > 0.9) & (surface.region == Region.TOP)
    assert clothes.shares.seen[back].mean() < 0.5 < clothes.shares.seen[front].mean()
    worn = np.median(clothes.colours[back], axis=0)
    np.testing.assert_allclose(worn, made_up.COLOURS[Region.TOP], atol=0.12)  # as beside it


def test_a_mask_of_what_hides_a_person_is_not_trusted() -> None:
    seen = made_up.views(made_up.WALKER, made_up.BOX)
    hidden = [replace(one, trust=one.trust.copy(), mask=one.mask.copy()) for one in seen]
    for view in hidden:
        view.mask[60:] = 0.0  # a wall before the legs
        view.trust[60:] = 0.0
    fit, _ = fit_person(hidden, made_up.BOX, False)
    assert fit.shape.height == pytest.approx(made_up.WALKER.height, rel=0.06)
    assert np.abs(fit.place).max() < 0.1
    assert box_from_body(made_up.BOX, fit.place)[2, 3] == -made_up.BOX[2] / 2


def test_a_large_image_is_compared_smaller() -> None:
    view = made_up.views(made_up.WALKER, made_up.BOX)[3]
    small = view.shrunk(48)
    assert small.mask.shape == (48, 36) == tuple(small.through.shape)
    assert small.image.shape == small.back.shape == small.front.shape == (48, 36, 3)
    assert small.camera.fx == pytest.approx(view.camera.fx / 2)
    assert small.mask.mean() == pytest.approx(view.mask.mean(), abs=1e-3)
    assert view.shrunk(96) is view
