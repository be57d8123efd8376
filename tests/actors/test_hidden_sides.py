"""Images of a track, split by the side that they show, and hidden from whoever trains a street."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.actors.observe import split_sides, without_sides
from recast.core.errors import InputError
from recast.logs.load import arc, log_info
from recast.reconstruction import SceneConfig
from recast.reconstruction.views import read_views
from support.recorded_drives import car, log

PASSED = log(tracks=[car(45.0, 6.0)])  # it stands 6 m to the left, and the ego passes
CONFIG = SceneConfig(scale=1.0, holdout_every=8)


@given(
    st.floats(0.0, 359.0),
    st.lists(st.floats(0.0, 170.0), min_size=1, max_size=8),
)
def test_an_arc_holds_all_directions_wherever_it_begins(start: float, along: list[float]) -> None:
    begins, length = arc([(start + one) % 360.0 - 180.0 for one in along])
    assert length == pytest.approx(max(along) - min(along), abs=1e-6)
    turned = (start + min(along) - 180.0 - begins + 180.0) % 360.0 - 180.0
    assert turned == pytest.approx(0.0, abs=1e-6)


def test_hidden_images_are_far_from_all_that_are_kept() -> None:
    sides = split_sides(PASSED, "7", CONFIG, 12.0)
    angles = {
        name: np.degrees([one.azimuth for one in getattr(sides, name)]) % 360.0
        for name in ("kept", "between", "hidden")
    }
    apart = np.abs(angles["kept"][:, None] - angles["hidden"][None])
    assert apart.min() > 12.0
    assert len(sides.kept) and len(sides.hidden)
    if len(angles["between"]):
        nearest = np.abs(angles["kept"][:, None] - angles["between"][None]).min(axis=0)
        assert (nearest <= 12.0).all()
    # no other border leaves more images in the smaller part
    everything = np.sort(np.concatenate(list(angles.values())))
    smaller = min(len(sides.kept), len(sides.hidden))
    for border in everything:
        low, high = (everything <= border).sum(), (everything > border + 12.0).sum()
        assert min(low, high) <= smaller
        low, high = (everything >= border).sum(), (everything < border - 12.0).sum()
        assert min(low, high) <= smaller


def test_a_track_seen_from_one_side_is_refused_with_its_span() -> None:
    [track] = log_info(PASSED).tracks
    with pytest.raises(InputError, match=r"is seen over \d+ degrees.*log info"):
        split_sides(PASSED, "7", CONFIG, 170.0)
    assert 20.0 < track.visibility.span < 120.0
    with pytest.raises(InputError, match="seen over 0 degrees"):
        split_sides(replace(PASSED, tracks=log(tracks=[car(-500.0)]).tracks), "7", CONFIG, 1.0)


def test_what_is_hidden_is_not_trained_on_and_all_else_is() -> None:
    sides = split_sides(PASSED, "7", CONFIG, 12.0)
    unseen = (*sides.between, *sides.hidden)
    views = read_views(without_sides(PASSED, "7", unseen), CONFIG)
    frames = {one.frame for one in unseen}
    for view in views:
        if view.frame not in frames:
            assert view.mask is None
            continue
        assert view.mask is not None and not view.mask.all() and view.mask.any()
        shown = without_sides(PASSED, "7", unseen).cameras["cam"].hidden[view.frame]
        left, top, right, bottom = np.clip(shown, 0, [159, 79, 159, 79]).astype(int)
        assert not view.mask[top:bottom, left:right].any()
    half = read_views(without_sides(PASSED, "7", unseen), CONFIG.model_copy(update={"scale": 0.5}))
    some = next(view for view in half if view.frame in frames)
    whole = next(view for view in views if view.frame == some.frame)
    assert some.mask is not None and whole.mask is not None
    assert some.mask.mean() == pytest.approx(whole.mask.mean(), abs=0.06)
