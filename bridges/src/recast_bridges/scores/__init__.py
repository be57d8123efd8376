"""Scores of other benchmarks beside the headline metrics: NAVSIM v2, AlpaSim, NeuroNCAP."""

from recast_bridges.scores.driven import DrivenEpdms, driven_epdms
from recast_bridges.scores.idm_traffic import IdmTraffic
from recast_bridges.scores.simulators import (
    NcapScore,
    SceneScore,
    alpasim_scene_score,
    neuroncap_mean,
    neuroncap_score,
    off_road,
)
from recast_bridges.scores.two_stage import (
    PlanScore,
    PlanSituation,
    SubmittedScene,
    TokenScore,
    TwoStage,
    TwoStageMapping,
    score_plan,
    score_scene,
    two_stage,
    write_two_stage,
)

__all__ = [
    "DrivenEpdms",
    "IdmTraffic",
    "NcapScore",
    "PlanScore",
    "PlanSituation",
    "SceneScore",
    "SubmittedScene",
    "TokenScore",
    "TwoStage",
    "TwoStageMapping",
    "alpasim_scene_score",
    "driven_epdms",
    "neuroncap_mean",
    "neuroncap_score",
    "off_road",
    "score_plan",
    "score_scene",
    "two_stage",
    "write_two_stage",
]
