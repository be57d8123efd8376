"""Impossible sizes and unknown names are refused, and the known ones listed."""

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.synthetic import scenery

RNG = np.random.default_rng(0)
BAD = (-1.0, 0.0, float("nan"), float("inf"), 1e6)


@pytest.mark.parametrize(
    ("call", "known"),
    [
        (lambda: scenery.building(RNG, 10, 10, "castle"), scenery.BUILDING_STYLES),
        (lambda: scenery.tree(RNG, 7.0, "palm"), scenery.TREE_STYLES),
        (lambda: scenery.fence(RNG, 7.0, "barbed"), scenery.FENCE_STYLES),
        (lambda: scenery.wall(RNG, 7.0, 2.0, "ice"), scenery.WALL_STYLES),
        (lambda: scenery.road_sign(RNG, "elk"), scenery.SIGN_KINDS),
        (lambda: scenery.traffic_signal(RNG, "blue"), scenery.SIGNAL_STATES),
    ],
)
def test_unknown_names_list_the_known(call, known) -> None:
    with pytest.raises(InputError) as caught:
        call()
    for name in known:
        assert name in str(caught.value)


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize(
    "call",
    [
        lambda v: scenery.building(RNG, v, 10, "urban"),
        lambda v: scenery.building(RNG, 10, v, "office"),
        lambda v: scenery.tree(RNG, v),
        lambda v: scenery.tree(RNG, 7.0, detail=v),
        lambda v: scenery.bush(RNG, v),
        lambda v: scenery.hedge(RNG, v),
        lambda v: scenery.hedge(RNG, 5.0, height=v),
        lambda v: scenery.hedge(RNG, 5.0, width=v),
        lambda v: scenery.lamp_post(RNG, v),
        lambda v: scenery.lamp_post(RNG, 8.0, v),
        lambda v: scenery.pole_line(RNG, v),
        lambda v: scenery.pole_line(RNG, 50.0, spacing=v),
        lambda v: scenery.pole_line(RNG, 50.0, height=v),
        lambda v: scenery.fence(RNG, v),
        lambda v: scenery.guard_rail(RNG, v),
        lambda v: scenery.wall(RNG, v, 2.0),
        lambda v: scenery.wall(RNG, 5.0, v),
        lambda v: scenery.bridge(RNG, v, 10, 5),
        lambda v: scenery.bridge(RNG, 10, v, 5),
        lambda v: scenery.bridge(RNG, 10, 10, v),
        lambda v: scenery.bridge(RNG, 10, 10, 5, approach=v),
        lambda v: scenery.hoarding(RNG, v),
        lambda v: scenery.hoarding(RNG, 6.0, v),
        lambda v: scenery.container(RNG, v),
    ],
)
def test_impossible_sizes(call, bad: float) -> None:
    with pytest.raises(InputError, match="give metres from"):
        call(bad)


@pytest.mark.parametrize(
    "call",
    [
        lambda: scenery.building(RNG, 10, 10, "urban", 0),
        lambda: scenery.building(RNG, 10, 10, "urban", 200),
        lambda: scenery.road_sign(RNG, "speed", -5),
        lambda: scenery.road_sign(RNG, "speed", 1000),
        lambda: scenery.road_sign(RNG, "speed", 12.5),
        lambda: scenery.pallets(RNG, 0),
        lambda: scenery.pallets(RNG, 21),
        lambda: scenery.bridge(RNG, 10, 10, 5, piers=(20.0,)),
        lambda: scenery.traffic_signal(RNG, "red", 1.0),
        lambda: scenery.traffic_signal(RNG, "red", float("nan")),
    ],
)
def test_impossible_counts_and_places(call) -> None:
    with pytest.raises(InputError):
        call()
