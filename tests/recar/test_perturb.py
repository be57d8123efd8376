"""Perturbations: every kind, and how they are drawn and put one on the other."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from recast.cli.recar_sets import Perturb
from recast.core.errors import InputError
from recast.core.files import write_json
from recast.recar import read_real_crops
from recast.recar.perturb import (
    PerturbationConfig,
    perturb,
    read_perturbations,
    surroundings,
    write_perturbations,
)
from recast.recar.perturb_camera import PerturbationKind, find_object
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
    # The quietest of 200 seeds adds just 0.5.
    room = 0.4 if kind.name == "compression" else 0.5
    assert effects[-1] > 1.5 * effects[0] + room


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


SMALL_CAR = drawn_car(48)
ALL_PERTURBED = PerturbationConfig(rho_clean=0.0)


def test_clean_with_probability_rho() -> None:
    config = PerturbationConfig(
        rho_clean=0.3, **{name.replace("-", "_"): {"weight": 0} for name in NAMES[4:]}
    )
    rng = np.random.default_rng(0)
    drawn = [perturb(SMALL_CAR, config, rng) for _ in range(400)]
    clean = [one for one in drawn if not one.applied]
    assert len(clean) / len(drawn) == pytest.approx(0.3, abs=0.06)
    assert all(one.rgba is SMALL_CAR for one in clean)
    assert {name for one in drawn for name, _ in one.applied} == set(NAMES[:4])


def test_results_pass_the_check_and_follow_the_configuration() -> None:
    rng = np.random.default_rng(1)
    order = {name: place for place, name in enumerate(NAMES)}
    counts, seen = set(), set()
    for _ in range(150):
        one = perturb(SMALL_CAR, ALL_PERTURBED, rng)
        check_crop(one.rgba, "result")
        places = [order[name] for name, _ in one.applied]
        assert places == sorted(set(places))
        assert all(0.1 <= severity <= 1 for _, severity in one.applied)
        counts.add(len(places))
        seen |= {name for name, _ in one.applied}
    assert counts == {1, 2, 3}
    assert seen == set(NAMES)


def test_equal_seeds_give_equal_pictures() -> None:
    for seed in range(10):
        one, other = (
            perturb(SMALL_CAR, ALL_PERTURBED, np.random.default_rng(seed)) for _ in range(2)
        )
        assert np.array_equal(one.rgba, other.rgba) and one.applied == other.applied


def test_draws_that_hide_too_much_are_drawn_again() -> None:
    """Cropping by half or more at each draw: only the milder ones can be left."""
    config = PerturbationConfig(
        rho_clean=0.0,
        composed=(1, 1),
        least_visible=0.75,
        **{name.replace("-", "_"): {"weight": 0} for name in NAMES if name != "cropping"},
    )
    rng = np.random.default_rng(0)
    whole = np.count_nonzero(SMALL_CAR[..., 3] > 204)
    for _ in range(60):
        left = perturb(SMALL_CAR, config, rng).rgba
        assert np.count_nonzero(left[..., 3] > 204) >= 0.75 * whole
    never = config.model_copy(
        update={"cropping": config.cropping.model_copy(update={"severity": (1.0, 1.0)})}
    )
    assert perturb(SMALL_CAR, never, rng).applied == ()


def test_large_pictures_are_cut_and_brought_down() -> None:
    large = np.pad(drawn_car(600), ((300, 50), (0, 200), (0, 0)))
    near = surroundings(large, 448)
    assert find_object(near).extent == pytest.approx(448, abs=2)
    assert near.shape[1] <= 1.52 * 448
    kept = surroundings(large, 2000)
    box, whole = find_object(kept), find_object(large)
    assert (box.width, box.height) == (whole.width, whole.height)


def test_a_picture_without_an_object_is_refused() -> None:
    with pytest.raises(InputError, match="zero everywhere"):
        perturb(np.zeros((20, 20, 4), np.uint8), PerturbationConfig(), np.random.default_rng(0))


def test_groups_of_the_paper_are_equally_likely() -> None:
    weights = {kind.name: kind.weight for kind in PerturbationConfig().kinds()}
    groups = [
        ("motion-blur", "defocus"),
        ("other-vehicle", "pole", "border"),
        ("erosion", "dilation", "holes", "leak", "jagged"),
    ]
    for group in groups:
        assert sum(weights.pop(name) for name in group) == pytest.approx(1)
    assert len(weights) == 5 and set(weights.values()) == {1.0}


def test_configuration_round_trip(tmp_path: Path) -> None:
    config = PerturbationConfig(rho_clean=0.5, fog={"visibility_m": 60, "weight": 2})
    write_perturbations(tmp_path / "c.json", config)
    assert read_perturbations(tmp_path / "c.json") == config


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"version": 2}, "version"),
        ({"format": "other"}, "format"),
        ({"rho_clean": 1.2}, "rho_clean"),
        ({"fog": {"severity": [0.8, 0.2]}}, "fog.severity"),
        ({"pole": {"weight": -1}}, "pole.weight"),
        ({"hail": {}}, "hail"),
        ({"composed": [0, 2]}, "composed"),
        ({name.replace("-", "_"): {"weight": 0} for name in NAMES}, "record"),
    ],
)
def test_bad_configurations_are_refused(
    tmp_path: Path, change: dict[str, object], field: str
) -> None:
    path = tmp_path / "c.json"
    write_json(path, {"format": "recast-perturbations", "version": 1, **change})
    with pytest.raises(InputError) as caught:
        read_perturbations(path)
    assert caught.value.field == field


def test_command_writes_sheet_and_configuration(tmp_path: Path) -> None:
    Image.fromarray(drawn_car(48)).save(tmp_path / "car.png")
    config = tmp_path / "all.json"
    Perturb(tmp_path / "car.png", tmp_path / "sheet.png", write_config=config)()
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert min(sheet.size) > 900
        assert np.asarray(sheet.convert("L")).std() > 20
    assert read_perturbations(config) == PerturbationConfig()


@pytest.mark.real_data
def test_real_crops_survive(shared: Path) -> None:
    rng = np.random.default_rng(0)
    for vehicle in read_real_crops(shared / "data" / "vehicles"):
        rgba = vehicle.inputs[0].rgba()
        for _ in range(6):
            check_crop(perturb(rgba, ALL_PERTURBED, rng).rgba, vehicle.id)
