"""Reconstruction: from a driving log to background, actors and sky as 3D Gaussians."""

from recast.scene.config import SceneConfig, read_config, write_config
from recast.scene.evaluate import evaluate_scene
from recast.scene.evaluate_record import FrameScore, SceneEvaluation
from recast.scene.evaluate_shifts import SHIFTS, ShiftedView, ShiftScores, ViewShift
from recast.scene.export import export_scene, export_scene_at
from recast.scene.presets import Preset, resolve_config
from recast.scene.render import SceneImage, SceneRasterizer, render_scene
from recast.scene.run import ProgressCallback, TrainingDisplay, TrainingStatus, read_training_config
from recast.scene.scores import RegionScore, psnr, ssim
from recast.scene.sky import SkyMap
from recast.scene.store import load_scene, save_scene
from recast.scene.street_scene import SceneActor, StreetScene
from recast.scene.train import TrainResult, train_scene

__all__ = [
    "SHIFTS",
    "FrameScore",
    "Preset",
    "ProgressCallback",
    "RegionScore",
    "SceneActor",
    "SceneConfig",
    "SceneEvaluation",
    "SceneImage",
    "SceneRasterizer",
    "ShiftScores",
    "ShiftedView",
    "SkyMap",
    "StreetScene",
    "TrainResult",
    "TrainingDisplay",
    "TrainingStatus",
    "ViewShift",
    "evaluate_scene",
    "export_scene",
    "export_scene_at",
    "load_scene",
    "psnr",
    "read_config",
    "read_training_config",
    "render_scene",
    "resolve_config",
    "save_scene",
    "ssim",
    "train_scene",
    "write_config",
]
