"""Published networks in folders of the user's: read strictly, never fetched."""

from recast.pretrained.batches import BATCH, in_batches
from recast.pretrained.clip import Clip, ClipImages
from recast.pretrained.clip_t5_load import clip_t5_files
from recast.pretrained.folder import PretrainedFolder, model_type
from recast.pretrained.pictures import (
    Picture,
    mean_colour,
    network_input,
    padded_square,
    resized,
    square_crop,
    whole_picture,
)
from recast.pretrained.vqa import VQA_SCORERS, VqaScorer, checked_scores, load_vqa_scorer

__all__ = [
    "BATCH",
    "VQA_SCORERS",
    "Clip",
    "ClipImages",
    "Picture",
    "PretrainedFolder",
    "VqaScorer",
    "checked_scores",
    "clip_t5_files",
    "in_batches",
    "load_vqa_scorer",
    "mean_colour",
    "model_type",
    "network_input",
    "padded_square",
    "resized",
    "square_crop",
    "whole_picture",
]
