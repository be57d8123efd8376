from dataclasses import replace

import numpy as np
import pytest
import shapely

from recast.core.errors import InputError
from recast.dynamics import PACIFICA, EgoState, make_state, plan_to_poses, track
from recast.dynamics import state as ego
from recast.geometry import boxes
from recast.geometry.boxes import bev_touching
from recast.logs.derive_map import map_of
from recast.planning import (
    ActorState,
    DrivingCommand,
    PlannerInput,
    PlanningContext,
    ReferenceRoute,
)
from recast.planning.gtrs import PRIMITIVES
from recast.planning.gtrs.expert import (
    FORESEEN,
    Expert,
    TargetObstacle,
    collisions,
    score_trajectories,
    steady_best,
)
from recast.planning.pdm import AgentKind, Forecast
from recast.planning.pdm.forecast import box_corners
from recast.planning.pdm.scorer import EgoAreas, at_fault_collisions, time_to_collision
from recast.planning.types import ego_status
from recast_tools.planner_training.evaluate import true_scores
from support.synthetic_drives import drive
from support.target_roads import moving, straight_road


def possible(state: np.ndarray) -> np.ndarray:
    return PRIMITIVES.trajectories(ego_status(DrivingCommand.STRAIGHT, state)[None])[0]


@pytest.mark.parametrize("seed", range(4))
def test_collisions_are_those_of_pdm_s_own_loops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = make_state(rng.normal(0, 1, 3), rng.uniform(3, 12))
    trajectories = possible(state).astype(np.float64)
    start = np.broadcast_to(state, (len(trajectories), 11))
    states = track(start, plan_to_poses(start[:, :3], trajectories), 40)
    obstacles = []
    for token in "abc":
        way = rng.uniform(-3.14, 3.14)
        aside = rng.uniform(-1, 1) if token == "a" else rng.uniform(-8, 8)
        car = moving(rng.uniform(9, 20), aside, way, rng.choice([0.0, 4.0, 9.0]))
        # PDM looks at obstacles every 0.2 s only.
        poses = car.poses[2 * (np.arange(FORESEEN + 1) // 2)]
        obstacles.append(TargetObstacle(token, poses, car.size))
    polygons = np.array(
        [
            [
                shapely.Polygon(boxes.bev_corners(o.poses[min(2 * m, FORESEEN)], *o.size[:2]))
                for o in obstacles
            ]
            for m in range(26)
        ],
        np.object_,
    )
    still = np.array([np.ptp(o.poses[:, :2]) == 0 for o in obstacles])
    seen = Forecast(
        tuple("abc"),
        (AgentKind.VEHICLE,) * 3,
        np.zeros(3),
        np.where(still, 0.0, 4.0),
        polygons,
        np.zeros(3, np.bool_),
    )
    everywhere, nowhere = np.ones(states.shape[:2], np.bool_), np.zeros(states.shape[:2], np.bool_)
    areas = EgoAreas(everywhere, nowhere, nowhere, nowhere)
    corners = box_corners(states[..., ego.POSE], PACIFICA)
    # The speed now, which PDM asks for, is not that of held poses.
    known = [
        o if s else replace(o, poses=_nudged(o.poses))
        for o, s in zip(obstacles, still, strict=True)
    ]
    safe, clear = collisions(states, known, PACIFICA)
    blamed = at_fault_collisions(states, corners, areas, seen).score
    np.testing.assert_array_equal(np.where(safe == 0.5, 1.0, safe), blamed)
    np.testing.assert_array_equal(clear, time_to_collision(states, corners, areas, seen).score)
    assert 0 < clear.sum() < len(clear)


def _nudged(poses: np.ndarray) -> np.ndarray:
    """The same poses, but that the first step moves by a centimetre."""
    found = poses.copy()
    found[1, 0] += 0.01
    return found


def test_overlap_is_that_of_polygons() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.uniform(-4, 4, (2, 300, 3))
    found = bev_touching(a, (5, 2), b, (4, 1.8))
    wanted = [
        shapely.Polygon(p).intersects(shapely.Polygon(q))
        for p, q in zip(boxes.bev_corners(a, 5, 2), boxes.bev_corners(b, 4, 1.8), strict=True)
    ]
    np.testing.assert_array_equal(found, wanted)
    assert 0 < found.sum() < 300


def test_on_a_free_road_the_best_drives_on_at_the_wanted_speed() -> None:
    state = make_state(np.zeros(3), 9.0)
    found = score_trajectories(possible(state), state, straight_road(10.0), [])
    best = possible(state)[found.best, -1]
    assert best[0] == pytest.approx(38.5, abs=1.5)
    assert abs(best[1]) < 0.5
    assert found.scores[0].min() == 255


def test_behind_a_standing_car_the_best_stops_before_it() -> None:
    state, road = make_state(np.zeros(3), 9.0), straight_road()
    found = score_trajectories(possible(state), state, road, [moving(30.0)])
    best = possible(state)[found.best, -1]
    assert 8.0 < best[0] < 30.0 - 4.5 / 2 - 4.049
    assert found.scores[0].min() == 0
    assert true_scores(found.scores[None])[0, found.best] > 0.7
    state = make_state(np.zeros(3))
    standing = score_trajectories(possible(state), state, road, [moving(9.0)])
    assert not possible(state)[standing.best].any()


def test_to_stop_before_an_oncoming_car_does_is_better_than_to_be_run_into_standing() -> None:
    # From 28 m on it comes 12 m towards the ego, and stops: there is room if the ego brakes now.
    state = make_state(np.zeros(3), 6.0)
    car = moving(28.0)
    poses = car.poses.copy()
    poses[:, 0] -= np.minimum(0.2 * np.arange(FORESEEN + 1), 12.0)
    found = score_trajectories(possible(state), state, straight_road(), [replace(car, poses=poses)])
    assert set(np.unique(found.scores[0])) == {0, 128, 255}
    assert found.scores[0, found.best] == 255
    standing = make_state(np.zeros(3))
    poses[:, 0] -= 10.0  # now nothing helps, but standing is half as bad
    found = score_trajectories(
        possible(standing), standing, straight_road(), [replace(car, poses=poses)]
    )
    assert found.scores[0, found.best] == 128 and not possible(standing)[found.best].any()


def test_where_nothing_helps_the_best_brakes_hardest() -> None:
    state = make_state(np.zeros(3), 14.0)
    found = score_trajectories(possible(state), state, straight_road(), [moving(9.0)])
    assert found.total.max() == 0.0
    metres = possible(state)[:, -1, 0]
    assert metres[found.best] == pytest.approx(metres.min(), abs=0.01)


def test_of_two_stops_that_are_as_safe_the_comfortable_one_is_better() -> None:
    state = make_state(np.zeros(3), 8.0)
    rates = [PRIMITIVES.paces[i].acceleration for i, _ in PRIMITIVES.entries]
    both = possible(state)[[rates.index(-6.0), rates.index(-2.2)]]
    far, near = (
        score_trajectories(both, state, straight_road(), [moving(x)]) for x in (40.0, 19.0)
    )
    assert (far.scores[0] == 255).all()
    assert far.best == 1
    np.testing.assert_array_equal(near.scores[0], [255, 0])
    assert near.best == 0


def test_an_oncoming_car_counts_as_it_truly_moves() -> None:
    state, road = make_state(np.zeros(3), 8.0), straight_road()
    coming = moving(45.0, heading=np.pi, speed=6.0)
    stops = replace(coming, poses=coming.poses[np.minimum(np.arange(FORESEEN + 1), 5)])
    through, waits = (
        score_trajectories(possible(state), state, road, [one]) for one in (coming, stops)
    )
    assert waits.scores[0].mean() > through.scores[0].mean()


def test_beside_the_lane_the_best_comes_back() -> None:
    state = make_state(np.array([0.0, 1.0, 0.0]), 8.0)
    found = score_trajectories(possible(state), state, straight_road(), [])
    assert possible(state)[found.best, -1, 1] < -0.4


def test_the_mirrored_street_gives_the_mirrored_scores() -> None:
    road = straight_road()
    here, there = moving(25.0, 0.8, 0.2, 3.0), moving(25.0, -0.8, -0.2, 3.0)
    left = make_state(np.array([0.0, 0.4, 0.05]), 8.0, 0.5, 0.1)
    right = make_state(np.array([0.0, -0.4, -0.05]), 8.0, 0.5, -0.1)
    one = score_trajectories(possible(left), left, road, [here])
    other = score_trajectories(possible(right), right, road, [there])
    np.testing.assert_array_equal(one.scores, other.scores[:, PRIMITIVES.mirror])


def test_what_suffices_only_just_is_not_the_best() -> None:
    """Of braking harder and harder one scores best; who may miss it brakes a little more."""
    rates = np.linspace(-4.0, 0.0, 9)
    times = 0.1 * np.arange(1, 41)
    fan = np.zeros((1, 9, 40, 3), np.float32)
    fan[0, :, :, 0] = 10.0 * times + rates[:, None] / 2 * times**2
    totals = np.linspace(0.8, 1.0, 9)[None]
    everything, some = np.ones((1, 9)), (rates <= -2.0)[None].astype(np.float64)
    assert steady_best(fan, totals, everything)[0] == 8  # on a free road nothing changes
    just = int((totals * some).argmax())
    assert rates[just] == -2.0
    assert steady_best(fan, totals * some, some)[0] < just


def told(future: np.ndarray | None) -> tuple[ActorState, ...]:
    """A car 30 m ahead that drives at 8 m/s, as it seems."""
    pose, size = np.array([70.0, 0.0, 0.0]), np.array([4.5, 1.9, 1.5])
    return (ActorState("car", "car", pose, np.array([8.0, 0.0]), size, future),)


def test_the_expert_brakes_for_what_it_is_told() -> None:
    """A car that will stop at once; one that goes on; one whose label ends while it drives."""
    log = drive(speed=8.0)
    route = ReferenceRoute.from_trajectory(log.world_from_rig)
    expert = Expert()
    expert.reset(PlanningContext(route, log.world_from_rig, map=map_of(log)))
    state = make_state(np.array([40.0, 0.0, 0.0]), 8.0)
    stops = np.tile([70.0, 0.0, 0.0], (80, 1))
    goes = stops + 0.8 * np.arange(80)[:, None] * [1.0, 0.0, 0.0]
    driven = {}
    for name, future in (("stops", stops), ("goes", goes), ("ends", goes[:9]), ("seems", None)):
        seen = PlannerInput(
            step=0,
            timestamp_us=log.world_from_rig.timestamps_us[0],
            ego=EgoState(state),
            ego_history=state[None],
            actors=told(future),
            command=DrivingCommand.STRAIGHT,
        )
        driven[name] = expert.plan(seen).waypoints[-1, 0]
    assert driven["stops"] < 26.0 < driven["goes"]
    assert driven["goes"] == driven["ends"] == driven["seems"]
    with pytest.raises(InputError, match="map: is missing"):
        expert.reset(PlanningContext(route, log.world_from_rig))
