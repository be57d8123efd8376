"""The calibration of the trust figure: known coefficients, signs, readable references, records."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import expit

from recast.actors.actor import Coverage
from recast.core.errors import InputError
from recast.metrics.trust import (
    FEATURES,
    SIGHTLESS,
    JudgedRollout,
    area_under_roc,
    calibrate,
    judge,
    packaged_calibration,
    read_calibration,
    reliability,
    write_calibration,
)
from recast.metrics.trust.features import TrustFeatures, VehicleView
from recast.metrics.trust.model import READ, fit_model, fit_rollouts, loss, trust_left_out

TRUE = {"held_out_ssim": 1.2, "view_angle_deg": -0.8, "collision": 0.5}
INTERCEPT = 0.4


def drawn(count: int, seed: int = 0) -> tuple[list[dict[str, float]], np.ndarray]:
    """Rollouts with three standard normal features, and verdicts drawn by the true model."""
    rng = np.random.default_rng(seed)
    table = rng.uniform(-np.sqrt(3), np.sqrt(3), (count, len(TRUE)))  # unit variance, no tails
    odds = INTERCEPT + table @ np.array(list(TRUE.values()))
    agrees = rng.random(count) < expit(odds)
    return [dict(zip(TRUE, row, strict=True)) for row in table.tolist()], agrees


def rollouts(count: int = 120, scenes: int = 4) -> list[JudgedRollout]:
    values, agrees = drawn(count)
    return [
        JudgedRollout(f"street-{i % scenes}", f"{i}", "p", "native", one, bool(right))
        for i, (one, right) in enumerate(zip(values, agrees, strict=True))
    ]


def test_known_coefficients_are_found() -> None:
    count = 4000
    values, agrees = drawn(count)
    model = fit_model(values, agrees, ridge=1e-6)
    table = np.stack([model.standardised(one) for one in values])
    columns = [READ.index(name) for name in TRUE]
    design = np.c_[np.ones(count), table[:, columns]]
    # The standard errors of maximum likelihood, from the Fisher information.
    chance = np.array([model.trust(one) for one in values])
    errors = np.sqrt(np.diag(np.linalg.inv(design.T * (chance * (1 - chance)) @ design)))
    found = [model.intercept, *model.coefficients[columns]]
    assert np.all(np.abs(np.array(found) - [INTERCEPT, *TRUE.values()]) < 4 * errors)
    others = [i for i in range(len(READ)) if i not in columns]
    assert np.all(model.coefficients[others] == 0.0)  # of features that no rollout has


def test_a_coefficient_never_has_the_wrong_sign() -> None:
    values, agrees = drawn(500)
    turned = fit_model(values, ~agrees)
    assert turned.coefficients[READ.index("held_out_ssim")] == 0.0
    assert turned.coefficients[READ.index("view_angle_deg")] == 0.0
    assert turned.coefficients[READ.index("collision")] < 0.0  # it may have either


def test_the_gradient_is_that_of_the_loss() -> None:
    rng = np.random.default_rng(3)
    table, labels = rng.normal(size=(20, 4)), (rng.random(20) < 0.5).astype(float)
    at, step = rng.normal(size=5), 1e-6
    _, gradient = loss(at, table, labels, 0.7)
    for i in range(5):
        move = step * np.eye(5)[i]
        slope = (
            loss(at + move, table, labels, 0.7)[0] - loss(at - move, table, labels, 0.7)[0]
        ) / (2 * step)
        # Of a central difference: rounding of the loss over the step.
        assert slope == pytest.approx(gradient[i], abs=100 * np.finfo(float).eps / step)


def test_a_missing_feature_changes_nothing_and_a_wild_one_little() -> None:
    values, agrees = drawn(500)
    model = fit_model(values, agrees)
    assert model.trust({}) == pytest.approx(expit(model.intercept))
    assert model.trust({"held_out_ssim": 1e9}) == model.trust({"held_out_ssim": 1e6})
    assert model.parts({"collision": 1.0})["held_out_ssim"] == 0.0


def test_alike_verdicts_give_finite_coefficients() -> None:
    values, _ = drawn(50)
    model = fit_model(values, np.ones(50, bool))
    assert np.isfinite(model.intercept) and np.all(np.isfinite(model.coefficients))
    assert model.trust(values[0]) > 0.9
    with pytest.raises(ValueError, match="0 rollouts"):
        fit_model([], [])


@pytest.mark.parametrize("levels", [2, 5, 1000])
def test_the_area_under_the_curve_is_the_share_of_pairs_in_order(levels: int) -> None:
    rng = np.random.default_rng(levels)
    trust, agrees = rng.integers(0, levels, 60) / levels, rng.random(60) < 0.7
    pairs = [
        1.0 if good > bad else 0.5 if good == bad else 0.0
        for good in trust[agrees]
        for bad in trust[~agrees]
    ]
    assert area_under_roc(trust, agrees) == pytest.approx(np.mean(pairs), abs=1e-12)
    assert area_under_roc(trust, np.ones(60, bool)) is None


def test_the_reliability_table() -> None:
    agrees = [True, True, False, True, False]
    some = [
        JudgedRollout(str(i), "s", "p", "a", {"collision": 0.0}, a) for i, a in enumerate(agrees)
    ]
    found = reliability(some, [1.0, 0.85, 0.9, 0.2, 0.1])
    assert [(one.count, one.agreeing) for one in found.bins] == [
        (1, 0.0),
        (1, 1.0),
        (0, None),
        (0, None),
        (3, pytest.approx(2 / 3)),
    ]
    assert found.bins[4].trust == pytest.approx((1.0 + 0.85 + 0.9) / 3)
    assert found.brier == pytest.approx((0 + 0.15**2 + 0.9**2 + 0.8**2 + 0.1**2) / 5)
    assert found.base_brier == pytest.approx(0.6 * 0.4)
    assert (found.rollouts, found.agreeing, found.scenes) == (5, 3, 5)
    assert found.verdict_auc == 0.5  # all have the same verdict


def test_a_scene_is_judged_without_its_own_rollouts() -> None:
    some = rollouts()
    trust = trust_left_out(some)
    for scene in ("street-0", "street-3"):
        model = fit_rollouts([one for one in some if one.scene != scene])
        for one, value in zip(some, trust, strict=True):
            if one.scene == scene:
                assert value == model.trust(one.features)
    with pytest.raises(ValueError, match="1 scene"):
        trust_left_out([one for one in some if one.scene == "street-0"])


def test_a_calibration_comes_back_from_disk(tmp_path: Path) -> None:
    some = rollouts()
    made, found = calibrate(some, ["g"])
    write_calibration(made, tmp_path / "trust.json")
    read = read_calibration(tmp_path / "trust.json")
    assert read == made
    assert read.left_out.auc == found.auc is not None and found.auc > 0.6
    assert read.data.scenes == tuple(f"street-{i}" for i in range(4)) and read.provisional
    whole = fit_rollouts(some)
    assert [read.model.trust(one.features) for one in some] == [
        whole.trust(one.features) for one in some
    ]
    assert {one.name: one.known for one in read.features}["seen"] == 0


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda v: v.update(version=9), "version"),
        (lambda v: v.update(format="x"), "format"),
        (lambda v: v["features"].pop(), "record"),
        (lambda v: v["features"][0].update(coefficient=-1.0), "record"),
        (lambda v: v["features"][0].update(scale=0.0), "features.0.scale"),
        (lambda v: v.update(intercept=None), "intercept"),
        (lambda v: v["left_out"].update(auc=1.5), "left_out.auc"),
        (lambda v: v["data"].pop("scenes"), "data.scenes"),
        (lambda v: v.update(more=1), "more"),
    ],
)
def test_a_damaged_calibration_is_one_line(
    change: Callable[[dict[str, Any]], object], field: str, tmp_path: Path
) -> None:
    path = tmp_path / "trust.json"
    write_calibration(calibrate(rollouts(), ["g"])[0], path)
    value = json.loads(path.read_text())
    change(value)
    path.write_text(json.dumps(value))
    with pytest.raises(InputError) as caught:
        read_calibration(path)
    assert caught.value.field == field
    assert "\n" not in str(caught.value)


def test_too_little_to_calibrate_is_one_line() -> None:
    for some, words in (
        ([one for one in rollouts() if one.scene == "street-1"], "at least 2 are needed"),
        ([one for one in rollouts() if one.agrees], "both true and false are needed"),
    ):
        with pytest.raises(InputError, match=words):
            calibrate(some, ["g"])


def test_the_packaged_calibration_is_read() -> None:
    calibration = packaged_calibration()
    assert 0 < calibration.data.agreeing < calibration.data.rollouts
    assert calibration.left_out.rollouts == calibration.data.rollouts


@pytest.mark.parametrize(
    ("odds", "words"),
    [(-4.0, "Fewer than 1 of 10"), (0.85, "About 7 of 10"), (4.0, "More than 9 of 10")],
)
def test_the_trust_in_tenths(odds: float, words: str) -> None:
    features = TrustFeatures({"collision": 0.0, "gap_m": 1.0}, {}, 0, 5, None, None)
    packaged = packaged_calibration()
    added = sum(packaged.model.parts(features.values).values())
    trust = judge(features, packaged.model_copy(update={"intercept": odds - added}))
    assert trust.value == pytest.approx(expit(odds))
    assert trust.words.startswith(f"{words} verdicts like this one are right:")


VALUES = {"collision": 0.0, "gap_m": 0.4, "plan_change_m": 3.2, "without_shares": 1.0}


def test_words_name_the_steps_and_what_is_not_known() -> None:
    calibration = packaged_calibration()
    view = VehicleView(900.0, "front", 74.2)
    missing = {"invented": "the target's shares were not measured", "least_ttc_s": "why"}
    features = TrustFeatures(VALUES, missing, 35, 60, view, None)
    trust = judge(features, calibration)
    assert trust.value == calibration.model.trust(VALUES)
    assert (
        "of 10 verdicts like this one are right: at the plan that mattered (step 35) the target "
        "was seen from its front (74° from the nearest view in the log)." in trust.words
    )
    assert "step 35 (the plan changed by 3.2 m) and step 60 (smallest gap, 0.4 m)" in trust.words
    assert "Not known: the target's shares were not measured." in trust.words
    assert list(trust.steps) == [35, 60]
    told = trust.to_json()
    assert told["features"] == {name: VALUES.get(name) for name in FEATURES}
    assert told["missing"] == missing
    coverage = Coverage(90.0, 0.3, 0.08, 0.62)
    shown = replace(features, coverage=coverage)
    assert "from its front (62% invented, 8% mirrored)." in judge(shown, calibration).words
    unseen = replace(features, view=None)
    assert "no camera showed the target" in judge(unseen, calibration).words
    assert SIGHTLESS.to_json()["value"] == 1.0
