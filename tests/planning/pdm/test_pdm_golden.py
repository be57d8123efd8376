"""Agreement with tuplan_garage's PDM-Closed, stage by stage, and over two closed loops."""

from functools import cache

import numpy as np
import pytest
from pdm_golden import DATA, FOLDER, ego_state, golden_map, golden_scene, vehicle

from recast.dynamics import state as ego
from recast.dynamics import track
from recast.dynamics.tracker import PDM_REFERENCE
from recast.planning.pdm import PdmClosed, PdmConfig, PdmPlan
from recast.planning.pdm.scorer import comfort_signals

GOLDEN = np.load(FOLDER / "pdm_closed.npz")
LOOPS = np.load(FOLDER / "pdm_closed_loop.npz")
PARITY = PdmConfig(reference_quirks=True)

STORED = 0.5e-9
"""The golden map has nine decimals."""

ARITHMETIC = 1e4 * 2.0**-53 * 180.0
"""Ten thousand roundings of the largest coordinate: 40 steps of some hundred operations each."""

TOLERANCE = 4 * STORED + ARITHMETIC
"""A pose between two points of the map moves with both coordinates of both."""

every_scenario = pytest.mark.parametrize("name", DATA["scenarios"])


@cache
def planned(name: str) -> tuple[PdmClosed, PdmPlan]:
    scene = golden_scene(name)
    pdm = PdmClosed(scene.planner_map, scene.route, config=PARITY)
    return pdm, pdm.plan(scene.state, scene.obstacles, scene.red)


def close(found, wanted, tolerance=TOLERANCE):
    np.testing.assert_allclose(found, wanted, rtol=0, atol=tolerance)


@every_scenario
def test_centreline(name):
    close(planned(name)[0].centreline.poses, GOLDEN[f"{name}.centerline"])


@every_scenario
def test_driver_model_and_leads(name):
    plan = planned(name)[1]
    steps = slice(0, 41)
    wanted = GOLDEN[f"{name}.idm_progress_velocity"]
    close(plan.unroll.leads[:, steps], GOLDEN[f"{name}.leading_agent"][:, steps])
    close(plan.unroll.states[:, steps], wanted[:, steps])
    close(plan.unroll.states[plan.best], wanted[plan.best])


@every_scenario
def test_proposals(name):
    close(planned(name)[1].proposals, GOLDEN[f"{name}.proposals"][:, :41])


@every_scenario
def test_simulation(name):
    close(planned(name)[1].simulated, GOLDEN[f"{name}.simulated"])


@every_scenario
def test_ego_areas(name):
    areas = planned(name)[1].scores.areas
    found = np.stack([areas.multiple_lanes, areas.non_drivable, areas.oncoming], axis=-1)
    np.testing.assert_array_equal(found, GOLDEN[f"{name}.ego_areas"])


@every_scenario
def test_scores(name):
    scores = planned(name)[1].scores
    np.testing.assert_array_equal(
        [scores.no_collision, scores.drivable, scores.direction], GOLDEN[f"{name}.multi_metrics"]
    )
    np.testing.assert_array_equal(scores.collision_step, GOLDEN[f"{name}.collision_time_idx"])
    np.testing.assert_array_equal(scores.ttc_step, GOLDEN[f"{name}.ttc_time_idx"])
    close(scores.metres, GOLDEN[f"{name}.progress_raw"])
    close([scores.progress, scores.ttc, scores.comfort], GOLDEN[f"{name}.weighted_metrics"])
    close(scores.total, GOLDEN[f"{name}.scores"])


@every_scenario
def test_plan(name):
    plan = planned(name)[1]
    assert plan.best == GOLDEN[f"{name}.best_idx"]
    assert plan.braked == GOLDEN[f"{name}.braked"]
    close(plan.trajectory, GOLDEN[f"{name}.trajectory"][:, :3])


@pytest.mark.parametrize("name", ["stationary", "cut_in"])
def test_closed_loop(name):
    pdm = PdmClosed(golden_map(), ["R1", "C1", "R2"], config=PARITY)
    wanted = LOOPS[f"{name}.ego_states"]
    states = [ego_state(5.0, 0.0, 0.0, wanted[0, ego.VX])]
    best = LOOPS[f"{name}.best_idx"]
    for cycle, (x, y, heading, speed) in enumerate(LOOPS[f"{name}.actor_at_cycle"]):
        plan = pdm.plan(states[-1], [vehicle("t", x, y, heading, speed)])
        # While the ego stands, all proposals are one and the last bit of their scores decides.
        assert plan.best == best[cycle] or np.ptp(plan.scores.total) < 1e-12
        states.extend(track(states[-1], plan.trajectory[:41], 5, PDM_REFERENCE)[1:])
    close(states, wanted)


def test_comfort_signals():
    comfort = np.load(FOLDER / "comfort.npz")
    signals = comfort_signals(comfort["comfort.states"])
    for ours, theirs in [
        ("jerk", "mag_jerk"),
        ("yaw_accel", "yaw_accel"),
        ("yaw_rate", "yaw_rate"),
    ]:
        # The reference rounds to eight decimals, twice for the jerk.
        close(signals[ours], comfort[f"comfort.{theirs}"], 5e-8)
