"""PDM-Closed: proposals along the centreline, simulated, scored, the best one driven."""

from recast.planning.pdm.closed import PdmClosed, PdmPlan
from recast.planning.pdm.forecast import Forecast, Kind, Obstacle, forecast
from recast.planning.pdm.lane_path import LanePath
from recast.planning.pdm.planner import PdmClosedPlanner
from recast.planning.pdm.scorer import Scores, score_proposals
from recast.planning.pdm.settings import PdmConfig

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
