"""GTRS-Dense: scores a vocabulary of trajectories against camera images."""

from recast.planning.gtrs.config import BackboneConfig, GtrsConfig, StageConfig
from recast.planning.gtrs.decision import GtrsDecision
from recast.planning.gtrs.folder import load_checkpoint, load_gtrs, save_gtrs
from recast.planning.gtrs.head import HEADS, IMITATION, METRICS
from recast.planning.gtrs.lens import Lens
from recast.planning.gtrs.loss import METRIC_WEIGHTS, training_loss, vocabulary_dropout
from recast.planning.gtrs.model import GtrsModel, empty_model, new_model
from recast.planning.gtrs.planner import GtrsPlanner
from recast.planning.gtrs.rig import nuplan_rig
from recast.planning.gtrs.scores import (
    COMBINED,
    VOCABULARY_ONLY,
    ScoreWeights,
    combined_trajectories,
    final_score,
    product_score,
)
from recast.planning.gtrs.views import NUPLAN_VIRTUAL, WAYMO_NATIVE, ViewLayout, network_input
from recast.planning.gtrs.vocabulary import read_vocabulary, write_vocabulary
from recast.planning.gtrs.weights import load_weights, read_weights
from recast.planning.status import ego_status

__all__ = [
    "COMBINED",
    "HEADS",
    "IMITATION",
    "METRICS",
    "METRIC_WEIGHTS",
    "NUPLAN_VIRTUAL",
    "VOCABULARY_ONLY",
    "WAYMO_NATIVE",
    "BackboneConfig",
    "GtrsConfig",
    "GtrsDecision",
    "GtrsModel",
    "GtrsPlanner",
    "Lens",
    "ScoreWeights",
    "StageConfig",
    "ViewLayout",
    "combined_trajectories",
    "ego_status",
    "empty_model",
    "final_score",
    "load_checkpoint",
    "load_gtrs",
    "load_weights",
    "network_input",
    "new_model",
    "nuplan_rig",
    "product_score",
    "read_vocabulary",
    "read_weights",
    "save_gtrs",
    "training_loss",
    "vocabulary_dropout",
    "write_vocabulary",
]
