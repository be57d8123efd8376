from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.recar.perturb import PerturbationConfig
from recast.recar.perturb_kind import PerturbationKind, find_object
from recast.trellis import check_crop

from .perturb_cars import difference, drawn_car

KINDS = PerturbationConfig().kinds()
CAR = drawn_car(100)
NAMES = [kind.name for kind in KINDS]
IN_LOG_PIXELS = ("resampling", "compression", "low-light")  # of the log's camera
MASKS_ONLY = ("other-vehicle", "pole", "border", "cropping", "erosion", "holes")

each_kind = pytest.mark.parametrize("kind", KINDS, ids=NAMES)


def spoil(kind: PerturbationKind, severity: float, seed: int, rgba: np.ndarray = CAR) -> np.ndarray:
    return kind(rgba, severity, np.random.default_rng(seed))


def test_the_kinds_of_the_paper_are_all_there() -> None:
    assert NAMES == [
        "other-vehicle",
        "pole",
        "border",
        "cropping",
        "fog",
        "motion-blur",
        "defocus",
        "low-light",
        "resampling",
        "compression",
        "erosion",
        "dilation",
        "holes",
        "leak",
        "jagged",
    ]


@each_kind
@pytest.mark.parametrize("extent", [24, 100])
def test_severity_0_changes_next_to_nothing(kind: PerturbationKind, extent: int) -> None:
    car = drawn_car(extent)
    for seed in range(3):
        assert difference(spoil(kind, 0.0, seed, car), car) < (0.8 if extent == 100 else 1.5)


@each_kind
def test_severity_1_changes_the_object_visibly_and_leaves_some_of_it(
    kind: PerturbationKind,
) -> None:
    opaque = CAR[..., 3] > 204
    for seed in range(3):
        spoilt = spoil(kind, 1.0, seed)
        assert difference(spoilt, CAR) > 1.0
        assert np.count_nonzero(spoilt[..., 3] > 204) > 0.3 * opaque.sum()
        check_crop(spoilt, kind.name)


@each_kind
@settings(max_examples=3, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_effect_grows_with_severity(kind: PerturbationKind, seed: int) -> None:
    # Steps fall now on, now beside the edge, so for `jagged` neighbouring severities may swap.
    severities = (0, 0.2, 1) if kind.name == "jagged" else (0, 0.3, 0.6, 1)
    effects = [difference(spoil(kind, severity, seed), CAR) for severity in severities]
    for weaker, stronger in pairwise(effects):
        assert stronger >= 0.95 * weaker
    assert effects[-1] > 1.5 * effects[0] + 0.4  # compression: 0.5 more at least, of 200 seeds


@each_kind
def test_result_depends_on_the_generator_alone(kind: PerturbationKind) -> None:
    before = CAR.copy()
    once, again = spoil(kind, 0.7, 5), spoil(kind, 0.7, 5)
    assert np.array_equal(once, again)
    assert np.array_equal(before, CAR)
    assert once.dtype == np.uint8 and once.shape == CAR.shape
    assert not np.shares_memory(once, CAR)


@each_kind
def test_colours_of_transparent_pixels_do_not_matter(kind: PerturbationKind) -> None:
    magenta = CAR.copy()
    magenta[magenta[..., 3] == 0] = (255, 0, 255, 0)
    assert difference(spoil(kind, 0.8, 2, magenta), spoil(kind, 0.8, 2)) < 1e-9


@pytest.mark.parametrize(
    "kind", [kind for kind in KINDS if kind.name not in IN_LOG_PIXELS], ids=lambda kind: kind.name
)
def test_effect_is_relative_to_the_extent(kind: PerturbationKind) -> None:
    """A larger picture of the object is spoilt about as much as a smaller one."""
    one, two = drawn_car(80), drawn_car(160)
    small = np.mean([difference(spoil(kind, 0.8, seed, one), one) for seed in range(5)])
    large = np.mean([difference(spoil(kind, 0.8, seed, two), two) for seed in range(5)])
    assert 0.5 < large / small < 2.0


@each_kind
@pytest.mark.parametrize("extent", [9, 20, 60])
def test_small_and_tight_pictures_are_taken(kind: PerturbationKind, extent: int) -> None:
    tight = drawn_car(extent, edge=0.1)
    for seed in range(4):
        assert spoil(kind, 1.0, seed, tight).shape == tight.shape


@pytest.mark.parametrize("name", MASKS_ONLY)
def test_what_takes_away_never_adds(name: str) -> None:
    kind = KINDS[NAMES.index(name)]
    for seed in range(4):
        assert np.all(spoil(kind, 0.8, seed)[..., 3] <= CAR[..., 3])


@pytest.mark.parametrize("name", ["dilation", "leak"])
def test_what_adds_keeps_the_object(name: str) -> None:
    kind = KINDS[NAMES.index(name)]
    for seed in range(4):
        spoilt = spoil(kind, 0.8, seed)
        solid = CAR[..., 3] == 255
        assert np.array_equal(spoilt[solid], CAR[solid])
        assert np.count_nonzero(spoilt[..., 3] > CAR[..., 3]) > 50


@pytest.mark.parametrize("name", ["fog", "low-light", "compression"])
def test_what_spoils_light_keeps_the_mask(name: str) -> None:
    assert np.array_equal(spoil(KINDS[NAMES.index(name)], 0.9, 1)[..., 3], CAR[..., 3])


def test_cropping_cuts_the_named_share_off_one_side() -> None:
    kind = PerturbationConfig().cropping
    whole = find_object(CAR)
    sides = set()
    for seed in range(30):
        left = find_object(spoil(kind, 1.0, seed))
        sides.add(
            (
                left.left != whole.left,
                left.right != whole.right,
                left.top != whole.top,
                left.bottom != whole.bottom,
            )
        )
        assert min(left.width / whole.width, left.height / whole.height) == pytest.approx(
            0.5, abs=0.02
        )
    assert {(True, False, False, False), (False, True, False, False)} <= sides
