"""GTRS-Dense: scores a vocabulary of trajectories against camera images."""

from recast.cameras.lenses import Lens
from recast.cameras.mounts import nuplan_rig
from recast.planning.gtrs.config import (
    NUPLAN_VIRTUAL,
    PRIMITIVES,
    WAYMO_NATIVE,
    BackboneConfig,
    BackboneStage,
    GtrsConfig,
    MotionPrimitives,
    ViewLayout,
    network_input,
)
from recast.planning.gtrs.model import HEADS, IMITATION, METRICS, GtrsModel, empty_model, new_model
from recast.planning.gtrs.planner import (
    GtrsDecision,
    GtrsPlanner,
    load_checkpoint,
    load_gtrs,
    load_weights,
    read_weights,
    save_gtrs,
)
from recast.planning.gtrs.scores import (
    COMBINED,
    METRIC_WEIGHTS,
    VOCABULARY_ONLY,
    ScoreWeights,
    combined_trajectories,
    final_score,
    product_score,
    read_vocabulary,
    training_loss,
    vocabulary_dropout,
    write_vocabulary,
)
from recast.planning.types import ego_status

__all__ = [
    "COMBINED",
    "HEADS",
    "IMITATION",
    "METRICS",
    "METRIC_WEIGHTS",
    "NUPLAN_VIRTUAL",
    "PRIMITIVES",
    "VOCABULARY_ONLY",
    "WAYMO_NATIVE",
    "BackboneConfig",
    "BackboneStage",
    "GtrsConfig",
    "GtrsDecision",
    "GtrsModel",
    "GtrsPlanner",
    "Lens",
    "MotionPrimitives",
    "ScoreWeights",
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
