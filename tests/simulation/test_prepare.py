from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.dynamics import VehicleParameters
from recast.geometry import boxes
from recast.logs.hdmap import HdMap, Lane
from recast.simulation import MOTIONS, RolloutSetup, StartSituation, ego_centre, prepare
from support.synthetic_drives import drive


def test_the_gap_is_from_bumper_to_bumper() -> None:
    setup = RolloutSetup(drive(seconds=20), "7", MOTIONS["cut-in-a"])
    start = prepare(setup)
    front = start.ego[0] + setup.vehicle.front_length
    rear = start.actor[0, 0] - setup.track.size[0] / 2
    assert rear - front == pytest.approx(6.0, abs=1e-6)


def test_a_long_log_is_not_cut() -> None:
    start = prepare(RolloutSetup(drive(seconds=20), "7", MOTIONS["cut-in-a"]))
    assert start.steps == 160
    assert start.cut_reason is None
    assert start.start_timestamp_us == 5_000_000
    assert start.log_ego.shape == (161, 4)
    np.testing.assert_allclose(start.log_ego[:, 0], np.arange(161), atol=1e-6)
    np.testing.assert_allclose(start.log_ego[:, 3], 10.0, atol=1e-6)


def test_the_start_waits_for_three_metres_a_second() -> None:
    log = drive(speed=10.0, seconds=20)
    poses = log.world_from_rig.poses.copy()
    poses[:30, 0, 3] = poses[30, 0, 3]
    waiting = replace(log, world_from_rig=replace(log.world_from_rig, poses=poses))
    start = prepare(RolloutSetup(waiting, "7", MOTIONS["cut-in-a"]))
    assert start.start_timestamp_us == 5_000_000 + 30 * 100_000
    # where waiting would leave too little log, the first frame counts
    start = prepare(RolloutSetup(waiting, "7", MOTIONS["cut-in-a"], steps=190))
    assert start.start_timestamp_us == 5_000_000


def test_a_short_log_cuts_with_a_reason() -> None:
    start = prepare(RolloutSetup(drive(seconds=8), "7", MOTIONS["cut-in-a"]))
    assert start.steps == 80
    assert start.cut_reason == "the log ends 8.0 s after the start"


def test_the_actor_leaving_the_road_cuts_with_a_reason() -> None:
    # 12 m/s for 3 s and then slowly to the end of the log: the actor gets there before the ego
    log = drive(speed=10, seconds=20)
    poses = log.world_from_rig.poses.copy()
    poses[:, 0, 3] = np.minimum(poses[:, 0, 3], 40 + 0.2 * np.arange(len(poses)))
    slow = replace(log, world_from_rig=replace(log.world_from_rig, poses=poses))
    start = prepare(RolloutSetup(slow, "7", MOTIONS["advancing-a"]))
    assert 10 < start.steps < 160
    assert "the actor would leave the recorded road" in start.cut_reason
    assert start.actor[-1, 0] <= start.route.length - 2.0
    longer = MOTIONS["advancing-a"].script  # the next state would be outside
    assert longer is not None
    assert start.actor[-1, 0] + start.actor[-1, 3] * 0.1 > start.route.length - 2.0


def test_too_little_road_is_refused() -> None:
    with pytest.raises(InputError, match=r"the actor would leave .* of 160 steps"):
        prepare(RolloutSetup(drive(speed=13, seconds=4), "7", MOTIONS["stationary-b"]))
    late = RolloutSetup(
        drive(seconds=20), "7", MOTIONS["cut-in-a"], start_timestamp_us=5_000_000 + 19_500_000
    )
    with pytest.raises(InputError, match=r"the log ends 0\.5 s after the start"):
        prepare(late)


def test_a_short_request_is_no_cut() -> None:
    assert prepare(RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], steps=5)).steps == 5


def test_a_start_outside_the_log_is_refused() -> None:
    setup = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], start_timestamp_us=0)
    with pytest.raises(InputError, match="start_timestamp_us: 0 lies outside the log"):
        prepare(setup)


def test_an_unknown_track_is_refused() -> None:
    with pytest.raises(InputError, match=r"track 12: is not in the log; choose one of 7, 9"):
        prepare(RolloutSetup(drive(), "12", MOTIONS["cut-in-a"]))


def test_an_overlap_at_the_start_is_refused() -> None:
    overlapping = replace(MOTIONS["stationary-a"], min_gap=-3.0, reserve=-30.0)
    with pytest.raises(InputError, match=r"overlap by .* at the start"):
        prepare(RolloutSetup(drive(), "7", overlapping))


def test_a_wide_ego_touching_nothing_is_let_through() -> None:
    setup = RolloutSetup(drive(), "7", MOTIONS["advancing-a"], vehicle=VehicleParameters(width=2.5))
    start = prepare(setup)
    ego = ego_centre(start.ego[:3], setup.vehicle.centre_offset)
    size = (setup.vehicle.length, setup.vehicle.width)
    assert boxes.bev_overlap_area(ego, size, start.actor[0, :3], setup.track.size) == 0.0


def test_the_cut_in_uses_the_neighbour_lane_of_the_map() -> None:
    x = np.linspace(0, 200, 40)

    def lane(name: str, y: float, right: str | None) -> Lane:
        line = np.stack([x, np.full(40, y), np.zeros(40)], axis=1)
        side = np.array([0.0, 1.6, 0.0])
        outline = np.array([[0, y - 1.6], [200, y - 1.6], [200, y + 1.6], [0, y + 1.6]])
        return Lane(name, line, line + side, line - side, outline, right_neighbour=right)

    hdmap = HdMap({"ego": lane("ego", 0.0, "right"), "right": lane("right", -3.2, None)}, ())
    start = prepare(RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], map=hdmap))
    assert start.actor[0, 1] == pytest.approx(-3.2, abs=1e-6)


@pytest.mark.parametrize(
    ("states", "problem"),
    [
        (np.zeros((160, 4)), r"its script returned float64 \(160, 4\), not numbers \(161, 4\)"),
        (np.zeros((161, 3)), r"its script returned float64 \(161, 3\)"),
        (np.full((161, 4), "a"), "its script returned <U1"),
        (np.full((161, 4), np.nan), r"its state 0 is \[nan"),
        (np.full((161, 4), 1e300), "its state 0 is"),
        (np.full((161, 4), -1.0), "its speed is negative in state 0"),
    ],
)
def test_a_motion_of_ones_own_must_script_states(states: np.ndarray, problem: str) -> None:
    class Own:
        name, setting = "own", "a"

        def script(self, start: StartSituation, steps: int, dt: float) -> np.ndarray:
            return states

    with pytest.raises(InputError, match=f"motion own: {problem}"):
        prepare(RolloutSetup(drive(), "7", Own()))
