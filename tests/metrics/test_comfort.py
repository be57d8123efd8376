"""COM: each check on its own, by plans that break just that one."""

import numpy as np
import pytest
from scipy.signal import savgol_filter

from recast.dynamics import make_state, track
from recast.dynamics.tracker import comfortable_plans, savgol_signals
from recast.metrics import driving

T = 0.1 * np.arange(41)


def from_speed(speed, heading=None):
    """A plan (1, 40, 3) with this speed (41,) and heading (41,)."""
    heading = np.zeros(41) if heading is None else heading
    steps = speed[:-1, None] * 0.1 * np.stack([np.cos(heading[:-1]), np.sin(heading[:-1])], -1)
    xy = np.cumsum(steps, axis=0)
    return np.concatenate([xy, heading[1:, None]], axis=1)[None]


def failed(plan, reading=driving.com_hugsim):
    return set(reading(plan).failed_checks()[0])


def test_cruising_and_standing_pass_everything():
    for reading in (driving.com_hugsim, driving.com_4_13, driving.com_nuplan_savgol):
        assert reading(from_speed(np.full(41, 8.0))).com.value == 1.0
        assert reading(np.zeros((3, 40, 3))).com.value == 1.0


@pytest.mark.parametrize(
    ("acceleration", "wanted"),
    [(2.35, set()), (2.45, {"lon_accel"}), (-4.0, set()), (-4.1, {"lon_accel"})],
)
def test_longitudinal_acceleration(acceleration, wanted):
    assert failed(from_speed(20.0 + acceleration * T)) == wanted


def test_comfortable_plans_are_those_that_com_counts():
    rng = np.random.default_rng(0)
    plans = np.concatenate([from_speed(22.0 + rate * T) for rate in rng.uniform(-5, 3, 60)])
    wanted = driving.com_hugsim(plans)
    found = comfortable_plans(plans)
    np.testing.assert_array_equal(found, wanted.passed.all(axis=1))
    assert found.mean() == wanted.com.value
    assert 0 < found.sum() < len(found)


def jerky(jerk):
    """Acceleration up and down at constant jerk, never above 1 m/s^2."""
    wave = np.abs((T * jerk / 2) % 2 - 1)
    return from_speed(10.0 + 0.1 * np.cumsum(2 * wave - 1))


@pytest.mark.parametrize(
    ("jerk", "hugsim", "strict"),
    [(4.0, set(), set()), (8.0, set(), {"lon_jerk"}), (8.5, {"lon_jerk"}, {"lon_jerk"})],
)
def test_jerk_limits(jerk, hugsim, strict):
    assert failed(jerky(jerk)) == hugsim
    assert failed(jerky(jerk), driving.com_4_13) == strict


@pytest.mark.parametrize("whole_window", [False, True])
def test_smoothing_is_scipys_filter(whole_window):
    rng = np.random.default_rng(0)
    lon, lat = rng.normal(0, 3, (2, 7, 41))
    heading = np.cumsum(rng.normal(0, 0.1, (7, 41)), axis=-1)
    size = np.hypot(lon, lat)
    found = savgol_signals(lon, lat, size, heading, 0.1, whole_window=whole_window)
    wide, narrow = (41, 41) if whole_window else (8, 15)

    def jerk(values):
        return savgol_filter(savgol_filter(values, 8, 2), narrow, 2, deriv=1, delta=0.1)

    wanted = {
        "lon_accel": savgol_filter(lon, wide, 2),
        "lat_accel": savgol_filter(lat, wide, 2),
        "lon_jerk": jerk(lon),
        "jerk": jerk(size),
        "yaw_rate": savgol_filter(heading, 5, 2, deriv=1, delta=0.1),
        "yaw_accel": savgol_filter(heading, 5, 3, deriv=2, delta=0.1),
    }
    assert found.keys() == wanted.keys()
    for name, values in wanted.items():
        # Both round sums of up to 41 products, of weights up to 1 / 0.1^2 at worst.
        bound = 2 * 41 * np.finfo(float).eps * 1e2 * np.abs([lon, size, heading]).max()
        np.testing.assert_allclose(found[name], values, rtol=0, atol=bound)


def test_yaw_rate():
    speed = np.full(41, 2.0)
    assert failed(from_speed(speed, 0.94 * T)) == set()
    assert failed(from_speed(speed, 0.96 * T)) == {"yaw_rate"}


def test_yaw_rate_through_pi():
    plan = from_speed(np.full(41, 2.0), 0.9 * T)
    wrapped = plan.copy()
    wrapped[..., 2] = (plan[..., 2] + np.pi) % (2 * np.pi) - np.pi
    assert failed(wrapped) == set()
    assert failed(wrapped, driving.com_nuplan_savgol) == set()


def test_yaw_acceleration():
    speed = np.full(41, 2.0)
    assert failed(from_speed(speed, 0.19 * np.sin(3.1 * T))) == set()
    assert failed(from_speed(speed, 0.21 * np.sin(3.1 * T))) == {"yaw_accel"}


def test_lateral_acceleration():
    """The check that HUGSIM's own code forgets."""
    assert failed(from_speed(np.full(41, 10.0), 0.48 * T)) == set()
    assert failed(from_speed(np.full(41, 10.0), 0.50 * T)) == {"lat_accel"}


def test_headings_of_a_standing_plan_do_not_count():
    plan = np.zeros((1, 40, 3))
    plan[0, ::2, 2] = 1.0
    assert failed(plan) == set()
    plan[0, :, 0] = np.linspace(0.026, 1.04, 40)
    assert failed(plan) >= {"yaw_rate", "yaw_accel"}


def test_smoothing_forgives_a_noisy_speed():
    noisy = from_speed(10.0 + 0.05 * (-1.0) ** np.arange(41))
    assert failed(noisy) == {"lon_jerk"}
    assert failed(noisy, driving.com_nuplan_savgol) == set()


def test_share_and_reason():
    plans = np.concatenate([from_speed(np.full(41, 8.0))] * 3 + [from_speed(8 + 3 * T)])
    result = driving.com_hugsim(plans)
    assert result.com.value == 0.75
    assert result.com.reason == "1 of 4 plans fail: lon_accel in 1"


def test_without_plans_there_is_no_value():
    for reading in (driving.com_hugsim, driving.com_nuplan_savgol):
        assert not reading(np.zeros((0, 40, 3))).com.valid


def driven(speed, yaw_rate=0.0, acceleration=0.0, count=41, dt=0.1):
    """States of a drive with these signals over time."""
    times = dt * np.arange(count)
    yaw_rate, acceleration = yaw_rate + 0 * times, acceleration + 0 * times
    poses = np.zeros((count, 3))
    poses[:, 2] = np.cumsum(yaw_rate) * dt
    return make_state(poses, speed + 0 * times, acceleration, yaw_rate)


@pytest.mark.parametrize(
    ("states", "wanted"),
    [
        (driven(8.0), set()),
        (driven(8.0, acceleration=2.39), set()),
        (driven(8.0, acceleration=2.41), {"lon_accel"}),
        (driven(8.0, acceleration=-4.04), set()),
        (driven(8.0, acceleration=-4.06), {"lon_accel"}),
        (driven(8.0, acceleration=-2.0 + T[:14], count=14), None),
        (driven(8.0, acceleration=-4.0 + 3.5 * T[:15], count=15), set()),
        # its magnitude falls and rises again, which a parabola over all of it makes twice as steep
        (driven(8.0, acceleration=-4.0 + 4.5 * T[:15], count=15), {"lon_jerk", "jerk"}),
        (driven(4.0, yaw_rate=0.94), set()),
        (driven(4.0, yaw_rate=0.96), {"yaw_rate"}),
        (driven(10.0, yaw_rate=0.48), set()),
        (driven(10.0, yaw_rate=-0.50), {"lat_accel"}),
    ],
)
def test_what_was_driven_is_held_to_nuplans_limits(states, wanted):
    found = driving.com_driven(states)
    if wanted is None:
        assert not found.com.valid and "1.4 s" in found.com.reason
        return
    assert {name for one in found.failed_checks() for name in one} == wanted
    assert found.com.value == (0.0 if wanted else 1.0)


def test_what_was_driven_names_the_worst_moment():
    states = driven(8.0, acceleration=np.where(np.abs(T - 2.0) < 0.65, -5.0, 0.0))
    reason = driving.com_driven(states).com.reason
    assert reason.startswith("lon_accel is -5.")
    assert "m/s^2 at " in reason and "(-4.05 to 2.4); lon_jerk is" in reason


def test_finer_steps_are_thinned_to_nuplans():
    fine, coarse = driven(8.0, acceleration=2.45, count=81, dt=0.05), driven(8.0, acceleration=2.45)
    found, wanted = driving.com_driven(fine, 0.05), driving.com_driven(coarse, 0.1)
    assert found.failed_checks() == wanted.failed_checks() == [["lon_accel"]]
    assert "steps of 0.2 s" in driving.com_driven(coarse, 0.2).com.reason


def test_a_plan_beside_the_ego_is_uncomfortable_and_its_drive_is_not():
    """As PDM-Closed's: plans lie on the centreline, wherever the ego is."""
    states = make_state(np.zeros(3), 11.0)[None]
    plans = []
    for _ in range(8):
        x, y = states[-1, :2]
        line = np.zeros((41, 3))
        line[:, 0] = x + 1.1 * np.arange(41)
        line[:, 1] = 1.0  # the centreline
        line[0] = states[-1, :3]
        plans.append(line[1:] - [x, y, 0.0])  # the heading is small
        states = np.concatenate([states, track(states[-1], line, 5)[1:]])
    planned = driving.com_hugsim(np.array(plans))
    assert {"lon_accel", "lon_jerk"} <= set(planned.failed_checks()[0])
    found = driving.com_driven(states)
    assert found.com.value == 1.0, found.com.reason
