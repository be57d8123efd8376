"""What holds of PDM-Closed whatever the scene, and what its quirks do."""

import numpy as np
import pytest
import shapely
from pdm_golden import DATA, ego_state, golden_map, golden_scene, mirrored, moved, vehicle

from recast.core.errors import InputError
from recast.dynamics import PACIFICA
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning.map import PlannerLane, PlannerMap
from recast.planning.pdm import Centreline, PdmClosed, PdmConfig, PdmPlan, forecast
from recast.planning.pdm.forecast import box_corners, outline
from recast.planning.pdm.proposals import brake_plan, brakes
from recast.planning.pdm.scorer import ego_areas

QUIRKS = {"quirks": PdmConfig(reference_quirks=True), "sane": PdmConfig()}
MOTION = np.array([310.0, -125.0, 2.1])

every_scenario = pytest.mark.parametrize("name", DATA["scenarios"])


def plan(scene, config: PdmConfig | None = None) -> PdmPlan:
    pdm = PdmClosed(scene.planner_map, scene.route, config=config)
    return pdm.plan(scene.state, scene.obstacles, scene.red)


def in_ego_frame(scene, found: PdmPlan) -> np.ndarray:
    return se2.relative(scene.state[ego.POSE], found.trajectory)


@every_scenario
def test_a_mirrored_scene_gives_the_mirrored_plan(name):
    scene = golden_scene(name)
    other = mirrored(scene)
    straight, reflected = plan(scene), plan(other)
    assert reflected.braked == straight.braked
    np.testing.assert_allclose(
        in_ego_frame(other, reflected) * [1, -1, -1], in_ego_frame(scene, straight), atol=1e-7
    )


@pytest.mark.parametrize("config", QUIRKS)
@pytest.mark.parametrize("name", ["cut_in", "left_turn_red", "ped_and_cone"])
def test_a_rigid_motion_of_the_scene_moves_the_plan_with_it(name, config):
    scene = golden_scene(name)
    other = moved(scene, MOTION)
    here, there = plan(scene, QUIRKS[config]), plan(other, QUIRKS[config])
    assert there.best == here.best
    np.testing.assert_allclose(
        in_ego_frame(other, there), in_ego_frame(scene, here), rtol=0, atol=1e-6
    )
    np.testing.assert_allclose(there.scores.total, here.scores.total, rtol=0, atol=1e-7)


def test_only_the_reference_brakes_for_one_step_in_every_plan():
    scene = golden_scene("free")
    kicked, calm = plan(scene, QUIRKS["quirks"]), plan(scene)
    fastest = 4
    assert kicked.unroll.states[fastest, 1, 1] == pytest.approx(8.0 - 0.3)
    assert calm.unroll.states[fastest, 1, 1] > 8.0


@pytest.mark.parametrize("config", QUIRKS)
def test_only_in_the_reference_a_red_light_inherits_the_speed_of_another_lead(config):
    # The vehicle enters the corridor behind the fast proposals and ahead of the slow ones. The
    # former have the red light at 80 m ahead, right after the latter had the vehicle.
    scene = golden_scene("left_turn_red")
    pdm = PdmClosed(scene.planner_map, scene.route, config=QUIRKS[config])
    entering = vehicle("x", 63.8, -10.0, np.pi / 3, 5.0)
    leads = pdm.plan(ego_state(60.0, 0.0, 0.0, 6.0), [entering], ["Al"]).unroll.leads[:5, 2:41]
    at_light = np.abs(leads[..., 0] - (80.0 - PACIFICA.front_length)) < 1e-6
    assert at_light.any()
    assert bool(np.any(leads[at_light][:, 1] > 0.0)) is (config == "quirks")


@pytest.mark.parametrize("config", QUIRKS)
def test_a_touched_obstacle_is_forgotten_for_good(config):
    pdm = PdmClosed(golden_map(), ["R1", "C1", "R2"], config=QUIRKS[config])
    state = ego_state(10.0, 0.0, 0.0, 3.0)
    blocker = vehicle("t", 18.0, 0.0, 0.0, 0.0)
    touched = vehicle("t", 15.0, 0.0, 0.0, 0.0)
    assert pdm.plan(state, [blocker]).unroll.leads[4, 40, 0] < 20.0
    pdm.plan(state, [touched])
    again = pdm.plan(state, [blocker])
    assert again.unroll.leads[4, 40, 0] == pdm.centreline.length
    assert np.all(again.scores.no_collision == 1.0)


def test_a_red_light_is_left_alone_only_from_within():
    red = [("Al", shapely.box(8.0, -3.0, 30.0, 3.0))]
    for x, ignored in ((12.0, True), (5.0, False)):
        pose = np.array([x, 0.0, 0.0])
        found = forecast(
            [], red, pose, outline(pose, PACIFICA), set(), steps=10, dt=0.1, radius=50.0
        )
        assert found.tokens == ("red_light_Al",)
        assert bool(found.ignored[0]) is ignored


def test_a_box_that_drives_backwards_is_forecast_backwards():
    reversing = vehicle("r", 30.0, 0.0, 0.0, -4.0)
    pose = np.zeros(3)
    found = forecast(
        [reversing], [], pose, outline(pose, PACIFICA), set(), steps=10, dt=0.1, radius=50.0
    )
    assert found.at(10)[0].centroid.x == pytest.approx(26.0)


def test_the_centreline_of_the_first_call_stays():
    pdm = PdmClosed(golden_map(), ["R1", "C1", "R2"])
    pdm.plan(ego_state(10.0, 0.0, 0.0, 5.0), [])
    first = pdm.centreline
    pdm.plan(ego_state(12.0, 3.5, 0.0, 5.0), [])
    assert pdm.centreline is first


def test_the_speed_limit_is_that_of_the_present_lane():
    pdm = PdmClosed(golden_map(), ["R1", "C1", "R2"])
    limited = pdm.plan(ego_state(10.0, 0.0, 0.0, 11.0), [])
    unknown = pdm.plan(ego_state(110.0, 0.0, 0.0, 11.0), [])
    assert limited.unroll.states[4, 5, 1] < 11.1
    assert unknown.unroll.states[4, 5, 1] > 11.2


@pytest.mark.parametrize("speed", [0.1, 1.0, 3.9, 4.8])
@pytest.mark.parametrize("acceleration", [-3.0, 0.0])
def test_the_emergency_brake_never_reverses_and_never_starts(speed, acceleration):
    state = ego_state(0.0, 0.0, 0.0, speed, acceleration)
    ahead = brake_plan(state, 80, 0.1, reference_quirks=False)[:, 0]
    assert np.all(np.diff(ahead) >= 0.0)
    assert ahead[-1] <= max(1.1 * (speed - 4.05), 0.0) * 8.0 + 1e-9
    if 0.2 < speed < 4.05:
        assert brake_plan(state, 80, 0.1, reference_quirks=True)[-1, 0] < 0.0


def test_the_emergency_brake_is_for_slow_egos_close_to_a_collision():
    assert brakes(5.0, 2.0)
    assert not brakes(5.1, 2.0)
    assert not brakes(5.0, 2.1)


def test_a_route_end_stops_the_ego():
    pdm = PdmClosed(golden_map(), ["R1", "C1", "R2"])
    found = pdm.plan(ego_state(150.0, 0.0, 0.0, 8.0), [])
    assert found.trajectory[-1, 0] + PACIFICA.front_length < 180.0
    assert found.unroll.states[found.best, -1, 1] < 1.0


def test_stretch_of_a_path():
    path = Centreline([[0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])
    assert path.stretch(0.5, 2.5, vertices_only=False).length == pytest.approx(2.0)
    assert path.stretch(0.5, 2.5, vertices_only=True).length == pytest.approx(1.0)
    assert path.stretch(1.2, 1.8, vertices_only=True).length == pytest.approx(0.6)
    assert path.stretch(3.0, 9.0, vertices_only=False).length == 0.0


def test_bad_input_is_one_line():
    with pytest.raises(InputError, match="lanes: are missing"):
        PdmClosed(PlannerMap({}), ["R1"])
    with pytest.raises(InputError, match="lacks block 'R7'"):
        PdmClosed(golden_map(), ["R1", "R7"])
    with pytest.raises(InputError, match="is empty"):
        PdmClosed(golden_map(), [])
    pdm = PdmClosed(golden_map(), ["R1", "C1", "R2"])
    with pytest.raises(InputError, match="away from the nearest lane of the route"):
        pdm.plan(ego_state(10.0, -90.0, 0.0, 5.0), [])


@pytest.mark.parametrize("seed", range(3))
def test_first_contacts_are_those_of_looking_at_every_box(seed):
    rng = np.random.default_rng(seed)
    others = [
        vehicle(str(i), *rng.uniform(-9, 9, 2), rng.uniform(-3, 3), speed)
        for i, speed in enumerate([0.0, 0.0, 3.0, 6.0, 9.0])
    ]
    red = [("Al", shapely.box(-5.0, -5.0, 5.0, 5.0))]
    far = np.array([-20.0, 0.0, 0.0])
    seen = forecast(others, red, far, outline(far, PACIFICA), {"4"}, steps=20, dt=0.1, radius=50.0)
    steps = np.repeat(np.arange(20), 2)
    poses = np.cumsum(rng.normal(0, 1, (6, len(steps), 3)) * [1.0, 1.0, 0.1], axis=1)
    corners, counted = box_corners(poses, PACIFICA), rng.uniform(size=poses.shape[:2]) < 0.7
    wanted = np.full((6, len(seen.tokens)), len(steps))
    for p, look, k in np.ndindex(6, len(steps), len(seen.tokens) - 1):  # less the red light
        meets = shapely.intersects(shapely.Polygon(corners[p, look]), seen.at(steps[look])[k])
        if counted[p, look] and meets:
            wanted[p, k] = min(wanted[p, k], look)
    found = seen.first_contacts(corners, steps, counted)
    np.testing.assert_array_equal(found, wanted)
    assert 0 < np.count_nonzero(found < len(steps)) < found.size - 6


@pytest.mark.parametrize(
    ("y", "between"), [(0.0, False), (2.0, True), (4.0, False)], ids=["lane", "both", "car park"]
)
def test_a_box_between_lane_and_car_park_is_in_two_lanes_but_not_for_navsim(y, between):
    lane = PlannerLane("a", "a", np.array([[0, 0, 0], [40, 0, 0]]), shapely.box(0, -2, 40, 2))
    road = PlannerMap({"a": lane}, car_parks=[shapely.box(0, 1.5, 40, 6)])
    pose = np.array([20.0, y, 0.0])
    args = road, ["a"], box_corners(pose, PACIFICA), pose, pose
    found = ego_areas(*args)
    assert found.multiple_lanes == found.irregular == between
    assert not ego_areas(*args, lanes_only=True).irregular
