from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.geometry import se2
from recast.logs.hdmap import HdMap, Lane
from recast.logs.types import DrivingLog, Track, Trajectory
from recast.planning import ReferenceRoute
from recast.simulation.actor_motion import neighbour_lateral
from support.synthetic_drives import drive


def log_with(*offsets: float, speed: float = 8.0, heading: float = 0.0) -> DrivingLog:
    log = drive(seconds=10)
    tracks = {}
    for i, offset in enumerate(offsets):
        times = log.world_from_rig.timestamps_us[:40]
        x = 5.0 + speed * np.cos(heading) * 0.1 * np.arange(40) + (40 if heading else 0)
        planar = np.stack([x, np.full(40, offset), np.full(40, heading)], axis=1)
        tracks[str(i)] = Track(
            str(i), "car", np.array([4, 1.8, 1.5]), Trajectory(times, se2.to_se3(planar))
        )
    return replace(log, tracks=tracks)


def found(log: DrivingLog, hdmap: HdMap | None = None) -> float | None:
    route = ReferenceRoute.from_trajectory(log.world_from_rig)
    return neighbour_lateral(log, hdmap, route, 5.0)


@pytest.mark.parametrize("offset", [3.3, -3.1])
def test_the_lane_in_which_a_recorded_vehicle_drove(offset: float) -> None:
    assert found(log_with(offset)) == pytest.approx(offset)


def test_the_side_where_more_were_seen() -> None:
    assert found(log_with(3.3, -3.2, -3.2)) == pytest.approx(-3.2)


@pytest.mark.parametrize(
    "log",
    [
        log_with(),
        log_with(0.3),  # in the ego's lane
        log_with(9.0),  # too far
        log_with(3.3, speed=0.0),  # parked
        log_with(3.3, heading=np.pi),  # oncoming
    ],
    ids=["none", "own-lane", "far", "parked", "oncoming"],
)
def test_what_is_no_neighbouring_lane(log: DrivingLog) -> None:
    assert found(log) is None


def lane(
    name: str, y: float, start: float = 0.0, left: str | None = None, right: str | None = None
) -> Lane:
    x = np.linspace(start, 200, 40)
    line = np.stack([x, np.full(40, y), np.zeros(40)], axis=1)
    side = np.array([0.0, 1.6, 0.0])
    outline = np.array([[start, y - 1.6], [200, y - 1.6], [200, y + 1.6], [start, y + 1.6]])
    return Lane(
        name,
        line,
        line + side,
        line - side,
        outline,
        left_neighbour=left,
        right_neighbour=right,
    )


def test_a_surveyed_map_comes_first() -> None:
    lanes = {"ego": lane("ego", 0.0, right="right"), "right": lane("right", -3.4)}
    assert found(log_with(3.3), HdMap(lanes, ())) == pytest.approx(-3.4)


def test_a_map_without_neighbours_leaves_it_to_the_traffic() -> None:
    alone = {"ego": lane("ego", 0.0)}
    assert found(log_with(3.3), HdMap(alone, (), derived=True)) == pytest.approx(3.3)


def test_a_neighbour_that_begins_further_on_does_not_count() -> None:
    lanes = {
        "ego": lane("ego", 0.0, left="left", right="right"),
        "left": lane("left", 3.4, start=60.0),
        "right": lane("right", -3.2),
    }
    assert found(log_with(), HdMap(lanes, ())) == pytest.approx(-3.2)


def test_traffic_comes_before_a_derived_map() -> None:
    lanes = {"ego": lane("ego", 0.0, right="right"), "right": lane("right", -2.6)}
    derived = HdMap(lanes, (), derived=True)
    assert found(log_with(-3.3), derived) == pytest.approx(-3.3)
    assert found(log_with(), derived) == pytest.approx(-2.6)
