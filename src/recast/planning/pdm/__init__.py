"""PDM-Closed: proposals along the centreline, simulated, scored, the best one driven."""

from recast.planning.pdm.centreline import LanePath
from recast.planning.pdm.closed import PdmClosed, PdmClosedPlanner, PdmPlan
from recast.planning.pdm.forecast import Forecast, Kind, Obstacle, forecast
from recast.planning.pdm.proposals import PdmConfig
from recast.planning.pdm.scorer import Scores, score_proposals

__all__ = [
    "Forecast",
    "Kind",
    "LanePath",
    "Obstacle",
    "PdmClosed",
    "PdmClosedPlanner",
    "PdmConfig",
    "PdmPlan",
    "Scores",
    "forecast",
    "score_proposals",
]
