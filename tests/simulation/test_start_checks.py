from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from moved_worlds import curved_world, moved

from recast.core.errors import InputError
from recast.logs.hdmap import HdMap
from recast.planning.pdm import PdmClosedPlanner
from recast.simulation import MOTIONS, RolloutSetup, prepare, run_rollout
from support.synthetic_drives import drive


def road(left: float, right: float) -> HdMap:
    """A straight road along the drive, from `right` to `left` of it."""
    return HdMap({}, (np.array([[-5, right], [400, right], [400, left], [-5, left]], float),))


def setup_on(hdmap: HdMap | None, name: str = "cut-in-a") -> RolloutSetup:
    return RolloutSetup(drive(), "7", MOTIONS[name], map=hdmap)


def test_an_actor_off_the_road_is_refused() -> None:
    # beside the ego without a neighbour known: 3.5 m to the left, from 2.6 m on
    with pytest.raises(InputError, match=r"start off the road: 0% of its box lies on the drivable"):
        prepare(setup_on(road(1.5, -1.5)))
    with pytest.raises(InputError, match=r"start off the road: 33% of its box"):
        prepare(setup_on(road(3.2, -1.5)))


def test_half_on_the_road_is_enough() -> None:
    assert prepare(setup_on(road(3.6, -1.5))).steps == 160
    assert prepare(setup_on(road(1.5, -1.5), "stationary-a")).steps == 160


def test_a_derived_map_or_none_refuses_nothing() -> None:
    assert prepare(setup_on(replace(road(1.5, -1.5), derived=True))).steps == 160
    assert prepare(setup_on(None)).steps == 160
    assert prepare(setup_on(HdMap({}, ()))).steps == 160


def test_a_map_of_elsewhere_is_refused() -> None:
    with pytest.raises(InputError, match=r"only 0% of the ego's route lies on the map; use a map"):
        prepare(setup_on(moved(curved_world(), (0.0, 900.0, 0.0)).map))


def test_an_actor_inside_the_ego_is_refused() -> None:
    inside = replace(MOTIONS["oncoming-a"], gap=-2.0)
    with pytest.raises(InputError, match=r"actor and ego overlap by 3\.\d+ m2 at the start"):
        prepare(RolloutSetup(drive(), "7", inside))


def test_a_map_without_lanes_is_refused_by_the_planner_that_needs_them() -> None:
    with pytest.raises(InputError, match="lanes: are missing"):
        run_rollout(setup_on(road(6.0, -6.0)), PdmClosedPlanner())
