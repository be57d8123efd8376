"""PDM-Closed: proposals along the centreline, simulated, scored, the best one driven."""

from recast.planning.pdm.closed import PdmClosed, PdmClosedPlanner, PdmPlan
from recast.planning.pdm.forecast import AgentKind, Forecast, Obstacle, forecast, observed
from recast.planning.pdm.proposals import Centreline, PdmConfig
from recast.planning.pdm.scorer import (
    ExtendedScores,
    Scores,
    extended_comfort,
    score_extended,
    score_proposals,
)

__all__ = [
    "AgentKind",
    "Centreline",
    "ExtendedScores",
    "Forecast",
    "Obstacle",
    "PdmClosed",
    "PdmClosedPlanner",
    "PdmConfig",
    "PdmPlan",
    "Scores",
    "extended_comfort",
    "forecast",
    "observed",
    "score_extended",
    "score_proposals",
]
