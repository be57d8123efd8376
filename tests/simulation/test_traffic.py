"""Traffic that stays: it is the log while nothing differs, and gives way where something does."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.core.errors import InputError
from recast.geometry import boxes, se2
from recast.logs.types import DrivingLog, Track, Trajectory
from recast.metrics import rollout_metrics
from recast.metrics.rollout_metrics import contacts_of_others
from recast.planning import Plan, PlannerInput
from recast.planning.simple import ConstantVelocity, LogReplay
from recast.simulation import MOTIONS, Rollout, RolloutSetup, Simulator, run_rollout
from recast.simulation.motions import LoggedMotion, Stationary, TimedPath
from recast.simulation.traffic import LoggedWay

CAR = np.array([4.2, 1.8, 1.5])
SECONDS = 12.0


def labelled(times: Sequence[float] | np.ndarray, places: Sequence[Sequence[float]]) -> Trajectory:
    """A path of labels at seconds (T,), with x, y, heading (T, 3)."""
    stamps = np.round(np.asarray(times) * 1e6).astype(np.int64)
    return Trajectory(stamps, se2.to_se3(np.asarray(places, np.float64), 0.75))


def driven(
    x: float, y: float, speed: float, begin: float = 0.0, end: float = SECONDS
) -> Trajectory:
    """A car at constant speed, at `x` at time 0, labelled ten times a second."""
    times = np.arange(round(begin * 10), round(end * 10) + 1) / 10
    return labelled(times, [(x + speed * t, y, 0.0) for t in times])


def drive(
    tracks: Mapping[str, Trajectory], sizes: Mapping[str, np.ndarray] | None = None
) -> DrivingLog:
    """An ego at 8 m/s along x, and cars."""
    sizes = sizes or {}
    return DrivingLog(
        "drive",
        {},
        {},
        driven(0.0, 0.0, 8.0),
        {key: Track(key, "car", sizes.get(key, CAR), path) for key, path in tracks.items()},
    )


def setup_of(log: DrivingLog, motion: object, **settings: object) -> RolloutSetup:
    options = {"start_timestamp_us": 1_000_000, "steps": 80, "traffic": "idm", **settings}
    return RolloutSetup(log, "target", motion, **options)  # type: ignore[arg-type]


def states(rollout: Rollout) -> dict[str, np.ndarray]:
    return {one.track_id: one.states for one in rollout.controlled}


def overlaps(rollout: Rollout, *pairs: tuple[str, str]) -> list[float]:
    """Largest overlap of each pair in m2."""
    found = {rollout.track_id: rollout.actor, **states(rollout), "ego": rollout.ego_boxes}
    size = {"ego": rollout.ego_size}
    return [
        float(
            boxes.bev_overlap_area(
                found[one][:, :3], size.get(one, CAR), found[other][:, :3], size.get(other, CAR)
            ).max()
        )
        for one, other in pairs
    ]


class Stops(ConstantVelocity):
    """Brakes at once and stands."""

    name = "stops"

    def plan(self, observation: PlannerInput) -> Plan:
        speed = observation.ego.speed
        ahead = [speed * t - 3.0 * t**2 for t in np.minimum(np.arange(1, 41) / 10, speed / 6)]
        return Plan(np.column_stack([ahead, np.zeros((40, 2))]))


CROWD = {
    "target": driven(30.0, 0.0, 8.0),
    "behind": driven(-25.0, 0.0, 8.0),
    "beside": driven(5.0, 3.5, 9.0),
    "oncoming": labelled([0, 12], [(120.0, 7.0, np.pi), (24.0, 7.0, np.pi)]),
    "parked": labelled([0, 12], [(60.0, -3.0, 0.0), (60.0, -3.0, 0.0)]),
    "late": driven(20.0, 3.5, 9.0, begin=3.0),
}


@pytest.mark.parametrize("kind", ["replay", "idm"])
def test_undisturbed_traffic_is_the_log(kind: str) -> None:
    log = drive(CROWD)
    rollout = run_rollout(setup_of(log, LoggedMotion(), traffic=kind), LogReplay())
    times = [rollout.timestamp_us(step) for step in range(rollout.steps_run + 1)]
    assert rollout.other_actors == ("behind", "beside", "oncoming", "parked", "late")
    for one in rollout.controlled:
        way = LoggedWay(log.tracks[one.track_id].trajectory)
        np.testing.assert_array_equal(one.states[:, :3], way.poses(times))
        np.testing.assert_array_equal(one.world_from_actor, way.in_space(times))
        inside = [log.tracks[one.track_id].trajectory.covers(time) for time in times]
        logged = log.tracks[one.track_id].trajectory.at(np.array(times)[inside])
        np.testing.assert_array_equal(one.world_from_actor[inside], logged)
        assert one.motion == "traffic" and one.setting == kind
    assert rollout.reactive == (rollout.other_actors if kind == "idm" else ())


def test_none_is_the_default_and_takes_everybody_out() -> None:
    log = drive(CROWD)
    bare = run_rollout(setup_of(log, LoggedMotion(), traffic="none"), LogReplay())
    assert bare.controlled == () and bare.other_actors == ()
    assert RolloutSetup(log, "target", LoggedMotion()).traffic == "none"


def test_a_row_of_cars_stops_behind_a_target_that_stands() -> None:
    """Each keeps its distance, and none drives through another: replayed traffic does."""
    row = {f"car-{n}": driven(-12.0 * n, 3.5, 8.0) for n in range(1, 4)}
    log = drive({"target": driven(40.0, 3.5, 8.0), **row})
    stands = TimedPath("a", ((0.0, 45.0, 3.5, 0.0), (100.0, 45.0, 3.5, 0.0)))
    pairs = [("target", "car-1"), ("car-1", "car-2"), ("car-2", "car-3")]
    yielding = run_rollout(setup_of(log, stands, steps=105), LogReplay())
    assert overlaps(yielding, *pairs) == [0.0] * 3
    found = states(yielding)
    assert found["car-1"][-1, 3] < 0.5
    gap = 45.0 - found["car-1"][-1, 0] - CAR[0]
    assert 1.0 < gap < 8.0
    replayed = run_rollout(setup_of(log, stands, traffic="replay"), LogReplay())
    assert overlaps(replayed, pairs[0])[0] > 1.0
    assert contacts_of_others(yielding) == []
    [(one, other, step), *_] = contacts_of_others(replayed)
    assert (one, other) == pairs[0]
    reached = np.flatnonzero(states(replayed)["car-1"][:, 0] > 45.0 - CAR[0])
    assert step == reached[0]


def test_who_drives_behind_gives_way_to_an_ego_that_brakes() -> None:
    log = drive({"target": driven(60.0, 0.0, 8.0), "behind": driven(-18.0, 0.0, 8.0)})
    yielding = run_rollout(setup_of(log, LoggedMotion()), Stops())
    assert yielding.ego[-1, 3] < 0.1
    assert overlaps(yielding, ("ego", "behind")) == [0.0]
    replayed = run_rollout(setup_of(log, LoggedMotion(), traffic="replay"), Stops())
    assert overlaps(replayed, ("ego", "behind"))[0] > 1.0
    assert rollout_metrics(replayed, None).collisions["behind"].first_step is not None


def test_a_car_drives_on_when_its_way_is_free_again_and_waits_as_long_as_logged() -> None:
    """It comes late to the place where the log saw it stand for 3 s, and stands there as long."""
    times = np.arange(0, 121) / 10
    way = np.interp(times, [0, 4, 7, 12], [-20.0, 12.0, 12.0, 52.0])
    waiting = labelled(times, [(x, 3.5, 0.0) for x in way])
    log = drive({"target": driven(60.0, 0.0, 8.0), "waits": waiting})
    # The target stands across its lane for a while, then it is gone.
    crossing = TimedPath(
        "a",
        ((0.0, 6.0, 3.5, 0.0), (2.0, 6.0, 3.5, 0.0), (2.5, 6.0, 40.0, 0.0), (99.0, 6.0, 40.0, 0.0)),
    )
    rollout = run_rollout(setup_of(log, crossing, steps=100), LogReplay())
    found = states(rollout)["waits"]
    assert overlaps(rollout, ("target", "waits")) == [0.0]
    standing = np.flatnonzero(np.abs(found[:, 0] - 12.0) < 0.05) * 0.1
    assert 2.7 < standing[-1] - standing[0] < 3.2  # as the log
    assert standing[0] > 4.0 - 1.0 + 1.0  # a second late at least
    assert np.all(np.diff(found[:, 0]) >= -1e-9) and found[-1, 3] > 5.0
    assert np.diff(found[:, 3]).max() <= 0.81  # logged 0 to 8 m/s within a label, at most


def test_boxes_that_overlap_in_the_log_drive_as_one() -> None:
    """A trailer with its own box brakes nobody, and is told."""
    log = drive(
        {
            "target": driven(60.0, 0.0, 8.0),
            "truck": driven(-20.0, 3.5, 8.0),
            "trailer": driven(-23.5, 3.5, 8.0),
        }
    )
    stands = TimedPath("a", ((0.0, 45.0, 3.5, 0.0), (100.0, 45.0, 3.5, 0.0)))
    with pytest.warns(RuntimeWarning, match="overlap in the log.*: trailer and truck"):
        rollout = run_rollout(setup_of(log, stands), LogReplay())
    found = states(rollout)
    assert overlaps(rollout, ("target", "truck")) == [0.0]
    assert found["truck"][-1, 0] > 25.0  # the trailer's box did not hold it


def test_who_stands_in_the_way_is_told() -> None:
    log = drive({"target": driven(30.0, 0.0, 8.0), "parked": driven(20.0, 0.0, 0.0)})
    there = TimedPath("a", ((0.0, 21.0, 0.0, 0.0), (100.0, 21.0, 0.0, 0.0)))
    with pytest.raises(InputError, match=r"track parked and the actor overlap .* traffic none"):
        run_rollout(setup_of(log, there), LogReplay())
    with pytest.raises(InputError, match=r"track beside and the ego overlap"):
        beside = drive({"target": driven(30.0, 0.0, 8.0), "beside": driven(0.0, 3.5, 8.0)})
        run_rollout(setup_of(beside, LoggedMotion(), start_left=3.0), LogReplay())
    on_ego = drive({"target": driven(30.0, 0.0, 8.0), "own": driven(1.0, 0.0, 8.0)})
    with pytest.warns(RuntimeWarning, match="track own is left out.* lies on the ego in the log"):
        assert run_rollout(setup_of(on_ego, LoggedMotion()), LogReplay()).other_actors == ()
    late = drive({"target": driven(30.0, 0.0, 8.0), "late": driven(20.0, 0.0, 8.0, begin=3.0)})
    there = TimedPath("a", ((0.0, 28.0, 0.0, 0.0), (100.0, 28.0, 0.0, 0.0)))
    with pytest.warns(RuntimeWarning, match="track late is left out.* is not labelled yet"):
        assert run_rollout(setup_of(late, there), LogReplay()).other_actors == ()


def test_a_track_that_was_torn_is_one_road_user() -> None:
    """Of one vehicle with two ids, the second would begin inside the first."""
    tracks = {
        "target": driven(30.0, 0.0, 8.0),
        "part-2": driven(-10.0, 3.5, 8.0, begin=4.1),
        "part-1": driven(-10.0, 3.5, 8.0, end=4.0),
    }
    with pytest.warns(RuntimeWarning, match="track part-2 is left out.* begin in track part-1"):
        rollout = run_rollout(setup_of(drive(tracks), LoggedMotion()), LogReplay())
    assert rollout.other_actors == ("part-1",)


def test_a_target_may_overlap_where_the_log_has_it_so() -> None:
    """The trailer of a target on its logged way stays, and does not brake for it."""
    tracks = {"target": driven(30.0, 3.5, 8.0), "trailer": driven(26.5, 3.5, 8.0)}
    with pytest.warns(RuntimeWarning, match="overlap in the log.*: target and trailer"):
        rollout = run_rollout(setup_of(drive(tracks), LoggedMotion()), LogReplay())
    away = rollout.actor[:, 0] - states(rollout)["trailer"][:, 0]
    np.testing.assert_allclose(away, 3.5, atol=1e-6)
    elsewhere = TimedPath("a", ((0.0, 36.0, 3.5, 0.0), (100.0, 836.0, 3.5, 0.0)))
    with pytest.raises(InputError, match="track trailer and the actor overlap"), pytest.warns():
        run_rollout(setup_of(drive(tracks), elsewhere), LogReplay())


def test_two_who_passed_closely_in_the_log_pass_when_late() -> None:
    """Boxes 0.25 m apart: each is within the other's margin, and neither may stop for ever."""
    tracks = {
        "target": driven(60.0, 30.0, 0.0),
        "a": driven(-15.0, 5.0, 8.0),
        "b": labelled([0, 12], [(60.0, 7.05, np.pi), (-36.0, 7.05, np.pi)]),
    }
    blocks, gone = (2.0, 5.0, 0.0), (2.0, 60.0, 0.0)
    rows = tuple(
        (t, *place) for t, place in ((0.0, blocks), (1.5, blocks), (2.0, gone), (99.0, gone))
    )
    rollout = run_rollout(setup_of(drive(tracks), TimedPath("a", rows), steps=100), LogReplay())
    found = states(rollout)
    assert found["a"][:, 3].min() < 6.0  # it was held up
    assert found["a"][-1, 0] > found["b"][-1, 0] and found["a"][-1, 3] > 7.0
    assert overlaps(rollout, ("a", "b")) == [0.0]
    assert found["b"][-1, 3] > 7.9


def test_who_has_gone_or_stays_far_away_is_no_traffic() -> None:
    tracks = {
        "target": driven(30.0, 0.0, 8.0),
        "comes": driven(-90.0, 3.5, 8.0, begin=11.0),
        "gone": driven(-10.0, 3.5, 8.0, end=0.9),
        "far": driven(300.0, 0.0, 8.0),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rollout = run_rollout(setup_of(drive(tracks), LoggedMotion()), LogReplay())
    assert rollout.other_actors == ()  # "comes" is labelled after the end


def test_a_branch_goes_on_as_the_whole() -> None:
    """Clocks are copied with the simulator, and begin anew with it."""
    log = drive({"target": driven(40.0, 3.5, 8.0), "behind": driven(-12.0, 3.5, 8.0)})
    stands = Stationary("a", min_gap=30.0, braking=4.0, reserve=0.0)
    simulator = Simulator(setup_of(log, stands))
    straight = Plan(np.column_stack([0.8 * np.arange(1, 41), np.zeros((40, 2))]))
    runs = []
    for _ in range(2):
        simulator.reset()
        while not simulator.done:
            if simulator.step_number == 20:
                branch = simulator.copy()
            simulator.step(straight)
        while not branch.done:
            branch.step(straight)
        runs += [simulator.rollout, branch.rollout]
    for other in runs[1:]:
        np.testing.assert_array_equal(states(runs[0])["behind"], states(other)["behind"])


def test_traffic_is_refused_by_another_name() -> None:
    with pytest.raises(InputError, match="traffic"):
        setup_of(drive(CROWD), MOTIONS["cut-in-a"], traffic="ghosts")


@given(
    steps=st.lists(st.floats(0.0, 3.0), min_size=2, max_size=30),
    begin=st.integers(0, 10_000_000),
    at=st.floats(-1.0, 2.0),
)
def test_distance_and_time_are_inverse(steps: list[float], begin: int, at: float) -> None:
    """`when` is the first time at which the way is as long, also where the car stands."""
    x = np.concatenate([[0.0], np.cumsum(np.where(np.array(steps) < 0.3, 0.0, steps))])
    times = begin + 100_000 * np.arange(len(x), dtype=np.int64)
    way = LoggedWay(Trajectory(times, se2.to_se3(np.column_stack([x, 0 * x, 0 * x]))))
    time = int(times[0] + at * (times[-1] - times[0]))
    metres = way.driven(time)
    found = way.when(metres, time)
    assert found <= time
    assert way.driven(found) == pytest.approx(metres, abs=30.0 * 2e-6 + 1e-9)  # rounded to 1 us
    assert np.hypot(*(way.poses(found) - way.poses(time))[:2]) < 1e-4
