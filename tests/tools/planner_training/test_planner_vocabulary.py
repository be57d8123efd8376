import numpy as np
import pytest

from recast.core.errors import InputError
from recast.dynamics.tracker import comfortable_plans
from recast_tools.planner_training.vocabulary import (
    make_vocabulary,
    mirror_index,
    mirrored,
    sample_driving,
    smooth_braking,
)


def speeds(trajectories: np.ndarray) -> np.ndarray:
    start = np.zeros((len(trajectories), 1, 2))
    steps = np.diff(np.concatenate([start, trajectories[..., :2]], axis=1), axis=1)
    return 10 * np.linalg.norm(steps, axis=-1)


def test_it_is_the_same_in_the_mirror_and_holds_nothing_twice(vocabulary: np.ndarray) -> None:
    index = mirror_index(vocabulary)
    np.testing.assert_array_equal(vocabulary[index], mirrored(vocabulary))
    np.testing.assert_array_equal(index[index], np.arange(len(vocabulary)))
    assert len(np.unique(vocabulary.reshape(len(vocabulary), -1), axis=0)) == len(vocabulary)
    assert not np.signbit(vocabulary[vocabulary == 0]).any()


def test_the_same_seed_gives_the_same_bytes(vocabulary: np.ndarray) -> None:
    assert make_vocabulary(128, 0).tobytes() == vocabulary.tobytes()
    assert make_vocabulary(128, 1).tobytes() != vocabulary.tobytes()


def test_it_stands_still_and_can_stop_from_thirteen_metres_a_second() -> None:
    vocabulary = make_vocabulary(512, 0)
    assert vocabulary.shape == (512, 40, 3)
    assert not vocabulary[0].any()
    speed = speeds(vocabulary)
    stops = (speed[:, 0] > 13.0) & (speed[:, -1] < 0.05)
    assert vocabulary[stops, -1, 0].min() < 13.0**2 / (2 * 6.0) + 4.0


def test_most_of_it_is_comfortable_stops_too() -> None:
    vocabulary = make_vocabulary(512, 0)
    speed = speeds(vocabulary)
    comfortable = comfortable_plans(vocabulary)
    stops = (speed[:, 0] > 1.0) & (speed[:, -1] < 0.05)
    assert comfortable.mean() > 0.8
    assert comfortable[stops].mean() > 0.6
    np.testing.assert_array_equal(comfortable, comfortable[mirror_index(vocabulary)])


@pytest.mark.parametrize("rate", [1.0, 2.5, 3.8])
@pytest.mark.parametrize("delay", [None, 0.0, 0.35, 1.0])
def test_smooth_braking_is_comfortable_and_stops_where_physics_says(
    rate: float, delay: float | None
) -> None:
    start = np.array([0.3, 2.0, 5.0, 9.0, 14.0])
    for to in (0.0, 0.5 * start):
        drives = smooth_braking(start, rate, delay, to).astype(np.float32)
        assert comfortable_plans(drives).all()
        change = np.diff(speeds(drives), axis=1)
        # Differences of positions that float32 rounds at 64 m, over 0.1 s.
        assert change.max() <= 4 * 32 * np.finfo(np.float32).eps / 0.1
        assert (speeds(drives)[:, -1] >= np.broadcast_to(to, 5) - 1e-3).all()
    stop = smooth_braking([4.0], 2.5, delay)[0, -1, 0]
    if rate == 2.5 and delay is not None:
        # A symmetric ramp of 4 m/s^3 lengthens the stop by half its duration.
        wanted = 4.0**2 / (2 * 2.5) + 4.0 * (delay + 2.5 / 4.0 / 2)
        # The trapezoidal rule over 0.1 s: h^2 / 12 times the change of acceleration's ends, 0,
        # but for knots between samples: at most h^2 / 8 times the jerk over four steps.
        assert stop == pytest.approx(wanted, abs=4 * 0.1 * 0.1**2 / 8 * 4.0)


def test_it_can_be_driven() -> None:
    drives = sample_driving(2000, np.random.default_rng(1))
    speed = speeds(drives)
    assert speed.max() < 16.0
    change = 10 * np.diff(speed, axis=1)
    assert change.min() > -6.5
    assert change.max() < 3.0
    # The rear axle moves along its heading.
    moved = np.diff(drives[..., :2], axis=1)
    middle = (drives[:, 1:, 2] + drives[:, :-1, 2]) / 2
    aside = moved[..., 1] * np.cos(middle) - moved[..., 0] * np.sin(middle)
    assert np.abs(aside).max() < 0.02
    turn = np.abs(np.diff(drives[..., 2], axis=1)) * 10
    assert (turn * speed[:, 1:]).max() < 9.0  # a bend and a shift, 4 m/s^2 each


def test_a_vocabulary_without_mirror_images_and_one_too_small_are_refused() -> None:
    with pytest.raises(InputError, match="no mirror image"):
        mirror_index(make_vocabulary(64, 0)[:-1])
    with pytest.raises(InputError, match="64 or more"):
        make_vocabulary(10)
