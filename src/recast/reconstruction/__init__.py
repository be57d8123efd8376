"""How a street is made of a driving log: first points, training, and the judging of both."""

from recast.reconstruction.config import (
    Preset,
    SceneConfig,
    read_config,
    resolve_config,
    write_config,
)
from recast.reconstruction.evaluate import (
    SHIFTS,
    FrameScore,
    SceneEvaluation,
    ShiftedView,
    ShiftScores,
    ViewShift,
    evaluate_scene,
)
from recast.reconstruction.scores import RegionScore, psnr, ssim
from recast.reconstruction.train import (
    ProgressCallback,
    TrainingStatus,
    TrainResult,
    load_preview,
    read_training_config,
    require_log_of,
    train_scene,
)

__all__ = [
    "SHIFTS",
    "FrameScore",
    "Preset",
    "ProgressCallback",
    "RegionScore",
    "SceneConfig",
    "SceneEvaluation",
    "ShiftScores",
    "ShiftedView",
    "TrainResult",
    "TrainingStatus",
    "ViewShift",
    "evaluate_scene",
    "load_preview",
    "psnr",
    "read_config",
    "read_training_config",
    "require_log_of",
    "resolve_config",
    "ssim",
    "train_scene",
    "write_config",
]
