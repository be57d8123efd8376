"""Straight, left and right, through both seams: the frame conventions."""

from __future__ import annotations

import numpy as np
import pytest

from recast.geometry import se2
from recast.planning import Planner, make_planner, simple
from recast.planning.simple import PROBE_CURVATURES, arc
from recast.simulation import PerfectController, probe_path
from recast_bridges.navsim import NavsimPlanner
from recast_bridges.navsim.planner import ProbeAgent


def _planners(name: str) -> dict[str, Planner]:
    attribute = name.replace("-", "_")
    return {
        "native": make_planner(f"recast.planning.simple:{attribute}"),
        "0.5 s": make_planner(f"navsim:recast_bridges.navsim.planner:{attribute}_agent"),
        "0.1 s": NavsimPlanner(ProbeAgent(name, 0.1)),
    }


@pytest.mark.parametrize("seam", ["native", "0.5 s", "0.1 s"])
def test_straight_keeps_the_course_and_arcs_turn_to_their_side(seam: str) -> None:
    paths = {name: probe_path(_planners(name)[seam], steps=20) for name in PROBE_CURVATURES}
    straight, left, right = paths["straight"], paths["left-arc"], paths["right-arc"]
    np.testing.assert_allclose(straight[:, 1:], 0.0, atol=1e-9)
    assert straight[-1, 0] == pytest.approx(16.0, abs=0.01)
    assert left[-1, 1] > 1.5 and left[-1, 2] > 0.2
    assert (np.diff(left[5:, 1:], axis=0) > 0).all()
    np.testing.assert_allclose(right, left * [1, -1, -1], atol=1e-9)  # the mirror image


@pytest.mark.parametrize("seam", ["native", "0.5 s", "0.1 s"])
def test_executed_without_lag_the_arc_is_met_to_the_millimetre(seam: str) -> None:
    path = probe_path(_planners("left-arc")[seam], steps=20, controller=PerfectController())
    expected = arc(0.02, 0.8 * np.arange(21))
    np.testing.assert_allclose(path[:, :2], expected[:, :2], atol=2e-3)
    np.testing.assert_allclose(path[:, 2], expected[:, 2], atol=2e-3)


def test_an_adapter_that_mixes_left_and_right_is_caught() -> None:
    class Mirrored(simple.ProbePlanner):
        def plan(self, observation):  # type: ignore[no-untyped-def]
            plan = super().plan(observation)
            plan.waypoints[:, 1:] *= -1
            return plan

    assert probe_path(Mirrored("left-arc"), steps=20)[-1, 1] < -1.5


def test_the_arc_is_a_circle() -> None:
    poses = arc(0.1, np.linspace(0, 31.4, 20))
    np.testing.assert_allclose(np.linalg.norm(poses[:, :2] - [0.0, 10.0], axis=1), 10.0)
    ahead = se2.relative(poses[:-1], poses[1:])
    np.testing.assert_allclose(ahead, np.tile(ahead[0], (19, 1)), atol=1e-12)
