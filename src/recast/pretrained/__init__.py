"""Published networks in folders of the user's: read strictly, never fetched."""

from recast.pretrained.clip_t5 import clip_t5_files
from recast.pretrained.folder import (
    BATCH,
    Picture,
    PretrainedFolder,
    in_batches,
    mean_colour,
    model_type,
    network_input,
    padded_square,
    resized,
    square_crop,
    whole_picture,
)
from recast.pretrained.image_text import (
    VQA_SCORERS,
    Clip,
    ClipImages,
    VqaScorer,
    checked_scores,
    load_vqa_scorer,
)

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
