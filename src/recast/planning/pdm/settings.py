"""Settings of PDM-Closed."""

from __future__ import annotations

from dataclasses import dataclass

from recast.dynamics import IdmParameters, TrackerConfig
from recast.dynamics.idm import PDM_BATCH
from recast.dynamics.tracker import DEFAULT, PDM_REFERENCE

DT = 0.1
"""Seconds per step. Its windows and look-aheads are counted in steps of this length."""


@dataclass(frozen=True)
class PdmConfig:
    """Settings of PDM-Closed; the defaults are the published planner's.

    `reference_quirks` reproduces tuplan_garage to the last digit, its slips included. Off:

    - Lead: known from the first step on. The reference takes a standing lead at its own bumper for
      one step, which brakes with 3 m/s^2 for 0.1 s in every plan.
    - Lead of one proposal: its own. The reference carries speed and length over from the proposal
      before where it does not set them.
    - End of the route: the front bumper stops there, not half the ego's length from the rear axle.
    - Speed of a proposal: never below zero.
    - Corridor: begins and ends where it should, not at the nearest vertices of the centreline.
    - Simulation: nuPlan's jerk matrix instead of the defective one.
    - Comfort: nuPlan's smoothing windows, not one over the whole proposal.
    - Map: all of it, not only what comes within 50 m of the ego.
    - Equal scores: the path nearest to the ego wins, then the slower proposal. The reference takes
      the first in its list, the right-hand one before the left-hand one.
    - Emergency brake: never backwards and, at a crawl, never forwards; see `emergency.py`.

    Attributes:
        reference_quirks: see above.
        lateral_offsets: metres to the left of the centreline, of the paths beside it.
        speed_fractions: target speeds as shares of the speed limit.
        default_speed_limit: m/s, where the lane has none.
        idm: the driver model of the proposals.
        proposal_steps: steps of a proposal, which is simulated and scored.
        plan_steps: steps of the plan, to which the best proposal is extended.
        radius: metres around the ego in which road users (and, with the quirks, the map) count.
    """

    reference_quirks: bool = False
    lateral_offsets: tuple[float, ...] = (-1.0, 1.0)
    speed_fractions: tuple[float, ...] = (0.2, 0.4, 0.6, 0.8, 1.0)
    default_speed_limit: float = 15.0
    idm: IdmParameters = PDM_BATCH
    proposal_steps: int = 40
    plan_steps: int = 80
    radius: float = 50.0

    @property
    def tracker(self) -> TrackerConfig:
        """The controller in the simulation of proposals."""
        return PDM_REFERENCE if self.reference_quirks else DEFAULT
