"""Agreement with nuPlan's, NAVSIM's and tuplan_garage's controllers."""

from pathlib import Path

import numpy as np
import pytest

from recast import dynamics
from recast.dynamics import state, tracker

COMMITTED = Path(__file__).parents[1] / "golden" / "planners" / "dynamics.npz"
TOLERANCE = 1e-9
KINDS = {"navsim": "reference", "nuplan": "correct"}


@pytest.fixture(params=["committed", "shared"])
def golden(request):
    """The committed analytic trajectories, and the whole set with vocabulary ones where present."""
    if request.param == "committed":
        return np.load(COMMITTED)
    folder = request.getfixturevalue("shared") / "golden" / "planners"
    return np.load(folder / "controller_comfort_idm.npz")


def close(found, wanted, tolerance=TOLERANCE):
    np.testing.assert_allclose(found, wanted, rtol=0, atol=tolerance)


def test_bicycle_step(golden):
    found = dynamics.BicycleModel().step(golden["bicycle.states"], golden["bicycle.commands"])
    close(found, golden["bicycle.next"])


@pytest.mark.parametrize("source", KINDS)
@pytest.mark.parametrize("name", ["velocity", "acceleration", "curvature", "curvature_rate"])
def test_profiles(golden, source, name):
    weights = dynamics.ProfileWeights(jerk_matrix=KINDS[source])
    profile = dynamics.fit_profile(golden["traj.poses"], weights=weights)
    close(getattr(profile, name), golden[f"profile_{source}.{name}"])


def test_pdm_reference_tracker(golden):
    states = dynamics.track(
        golden["sim.init"], golden["traj.poses"], 40, dynamics.PRESETS["pdm_reference"]
    )
    close(states, golden["sim.states"])


def test_pdm_reference_commands(golden):
    poses, config = golden["traj.poses"], tracker.PDM_REFERENCE
    profile = dynamics.fit_profile(poses, weights=config.profile)
    for index in range(40):
        command = dynamics.lqr_command(
            golden["sim.states"][:, index], poses, profile, index, config.lqr
        )
        close(command, golden["sim.commands"][:, index])


def test_default_tracker_is_nuplans(golden):
    states = dynamics.track(golden["sim.init"], golden["traj.poses"], 38)
    close(states, golden["sim_nuplan.states"])


def test_pdm_driver_model(golden):
    fractions = np.array([0.2, 0.4, 0.6, 0.8, 1.0])[golden["idm_batch.policy_idx"] % 5]
    found = dynamics.idm_step(
        golden["idm_batch.state"],
        golden["idm_batch.lead"],
        fractions * golden["idm_batch.speed_limit"],
        state.PDM_BATCH,
    )
    close(found, golden["idm_batch.next"])


def test_nuplan_driver_model(golden):
    agent = state.IdmParameters(max_acceleration=1.0, max_deceleration=2.0)
    found = dynamics.idm_step(golden["idm_batch.state"], golden["idm_batch.lead"], 10.0, agent)
    close(found, golden["idm_nuplan.next"])
