"""Agreement with the independent script's numbers and with nuPlan's comfort signals."""

import json
from pathlib import Path

import numpy as np
import pytest
import shapely

from recast.dynamics import PACIFICA
from recast.metrics import cluster_bootstrap, driving, exact_bootstrap
from recast.metrics.driving import drivable_area_compliance, no_collision, route_completion
from recast.simulation.rollout import ego_centre

FOLDER = Path(__file__).parents[1] / "golden" / "planners"
SIZE = np.array([5.176, 2.297])
STEPS = 5 * np.arange(32)
NC, DAC, TTC, TTC_CV, R_C, R_C_PROJECTION, COM, COM_4_13, FIRST_STEP = range(9)


@pytest.fixture(scope="module")
def golden():
    return np.load(FOLDER / "metrics.npz")


@pytest.fixture(scope="module")
def with_plans(shared):
    return np.load(shared / "golden" / "planners" / "metrics.npz")


@pytest.fixture(scope="module")
def vocabulary(shared):
    return np.load(shared / "golden" / "planners" / "vocab_8192.npy").astype(float)


@pytest.mark.parametrize("i", range(6))
def test_collision_drivable_and_progress(golden, i):
    ego, actor, wanted = golden["ego"][i], golden["actor"][i], golden["results"][i]
    boxes = ego_centre(ego[:, :3], PACIFICA.centre_offset)
    collision = no_collision(boxes, SIZE, actor, golden["actor_dims_lw"][i], 0.1)
    assert collision.nc.value == wanted[NC]
    first = -1 if collision.first_step is None else collision.first_step
    assert first == wanted[FIRST_STEP]
    region = shapely.Polygon(golden["drivable"])  # holds the tolerance already
    drivable = drivable_area_compliance(boxes, SIZE, region, 0.1, tolerance=0.0)
    assert drivable.dac.value == wanted[DAC]
    progress = route_completion(ego, golden["route"], collision.first_step)
    assert progress.r_c.value == pytest.approx(wanted[R_C], abs=1e-9)
    assert progress.r_c_projection.value == pytest.approx(wanted[R_C_PROJECTION], abs=1e-9)


@pytest.mark.parametrize("i", range(6))
@pytest.mark.parametrize(
    ("reading", "column", "future"),
    [("realised", TTC, driving.realised_future), ("cv", TTC_CV, driving.constant_velocity_future)],
)
def test_time_to_collision(with_plans, i, reading, column, future):
    ego, actor = with_plans["ego"][i], with_plans["actor"][i]
    found = driving.time_to_collision(
        ego[STEPS, :3],
        with_plans["predictions"][i],
        SIZE,
        PACIFICA.centre_offset,
        future(actor, STEPS),
        with_plans["actor_dims_lw"][i],
        STEPS,
    )
    np.testing.assert_allclose(
        found.per_cycle, with_plans[f"ttc_per_cycle_{reading}"][i], rtol=0, atol=1e-9
    )
    assert found.ttc.value == pytest.approx(with_plans["results"][i, column], abs=1e-9)


@pytest.mark.parametrize("i", range(6))
def test_comfort_checks(with_plans, i):
    plans, wanted = with_plans["predictions"][i], with_plans["results"][i]
    headline, strict = driving.com_hugsim(plans), driving.com_4_13(plans)
    np.testing.assert_array_equal(headline.passed, with_plans["comfort_checks"][i])
    np.testing.assert_array_equal(strict.passed, with_plans["comfort_checks_j413"][i])
    assert headline.com.value == wanted[COM] and strict.com.value == wanted[COM_4_13]


def test_vocabulary_passes_as_often_as_the_readings_say(vocabulary):
    readings = (driving.com_hugsim, driving.com_4_13, driving.com_nuplan_savgol)
    shares = [reading(vocabulary).com.value for reading in readings]
    assert shares == pytest.approx([0.724, 0.437, 0.998], abs=1e-3)


def test_nuplans_smoothed_signals():
    """NAVSIM v2's flavour: the longitudinal acceleration is moved to the box centre."""
    golden = np.load(FOLDER / "comfort.npz")
    states = golden["comfort.states"]
    ax, ay, rate, rate_change = states[..., 5], states[..., 6], states[..., 9], states[..., 10]
    lon = ax + PACIFICA.centre_offset * (rate**2 + rate_change)
    signals = driving.savgol_signals(lon, ay, np.hypot(ax, ay), states[..., 2], 0.1)
    names = {"jerk": "mag_jerk"}
    for name, values in signals.items():  # the reference rounds to eight decimals, twice for jerk
        wanted = golden[f"comfort.{names.get(name, name)}"]
        np.testing.assert_allclose(values, wanted, rtol=0, atol=3e-8)
    order = ["lon_accel", "lat_accel", "jerk", "lon_jerk", "yaw_accel", "yaw_rate"]
    limits = {name: driving.NUPLAN_LIMITS[name] for name in order}
    passed = driving.check(signals, limits, strict=True)
    np.testing.assert_array_equal(passed, golden["comfort.pass6"])


@pytest.mark.parametrize("metric", ["nc", "ttc"])
def test_bootstrap(metric):
    data = np.load(FOLDER / "bootstrap.npz")
    wanted = json.loads((FOLDER / "bootstrap.json").read_text())[metric]
    scenes = data[f"{metric}_recast"] - data[f"{metric}_native"]
    sampled = cluster_bootstrap(scenes, np.random.default_rng(0))
    found = [sampled.point, sampled.low, sampled.high, sampled.mean, sampled.std]
    np.testing.assert_allclose(found, wanted["mc_seed0"], rtol=0, atol=1e-9)
    exact = exact_bootstrap(scenes)
    found = [exact.low, exact.high, exact.mean, exact.std]
    np.testing.assert_allclose(found, wanted["exact"][2:], rtol=0, atol=1e-9)
