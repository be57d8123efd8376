"""Scores of other benchmarks beside the headline metrics: NAVSIM v2, AlpaSim, NeuroNCAP."""

from recast.metrics.foreign.alpasim import SceneScore, alpasim_scene_score, off_road
from recast.metrics.foreign.driven import DrivenEpdms, driven_epdms
from recast.metrics.foreign.epdms import PlanScore, Situation, score_plan
from recast.metrics.foreign.idm_traffic import IdmTraffic
from recast.metrics.foreign.neuroncap import NcapScore, neuroncap_mean, neuroncap_score
from recast.metrics.foreign.submission import Scene, TokenScore, score_scene
from recast.metrics.foreign.two_stage import (
    TwoStage,
    TwoStageMapping,
    two_stage,
    write_two_stage,
)

__all__ = [
    "DrivenEpdms",
    "IdmTraffic",
    "NcapScore",
    "PlanScore",
    "Scene",
    "SceneScore",
    "Situation",
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
