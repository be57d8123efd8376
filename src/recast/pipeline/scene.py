"""Training and judging a scene with a display for the terminal."""

from __future__ import annotations

from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from recast.logs import DrivingLog
from recast.scene import (
    SceneConfig,
    SceneEvaluation,
    TrainingDisplay,
    TrainResult,
    evaluate_scene,
    load_scene,
    read_training_config,
    train_scene,
)
from recast.scene.importers import IMPORT_FILE


def train_with_display(
    log: DrivingLog, out: str | Path, config: SceneConfig, console: Console | None = None
) -> TrainResult:
    """Train a scene, or go on with one, while showing progress and time left."""
    with TrainingDisplay(console) as display:
        return train_scene(log, out, config, progress=display)


def evaluate_and_print(
    scene: str | Path, log: DrivingLog, out: str | Path, console: Console | None = None
) -> SceneEvaluation:
    """Score a scene's held-out images, write eval.json and pictures, print a table.

    A scene that another program trained is scored on the images that ours would keep by default.
    """
    imported = (Path(scene) / IMPORT_FILE).is_file()
    config = SceneConfig() if imported else read_training_config(scene)
    evaluation = evaluate_scene(load_scene(scene), log, config, out)
    (console or Console()).print(evaluation_table(evaluation), f"pictures: {out}", sep="\n")
    return evaluation


def evaluation_table(evaluation: SceneEvaluation) -> Table:
    """Held-out scores as a table for the console."""
    table = Table(title="held-out images", title_justify="left", box=SIMPLE_HEAD)
    for heading in ("region", "images", "PSNR dB", "SSIM"):
        table.add_column(heading)
    frames = str(len(evaluation.frames))
    table.add_row("whole image", frames, f"{evaluation.psnr:.2f}", f"{evaluation.ssim:.3f}")
    for track, value in evaluation.box_psnr_by_track().items():
        seen = sum(track in frame.boxes for frame in evaluation.frames)
        table.add_row(f"box of track {track}", str(seen), f"{value:.2f}", "")
    if evaluation.box_psnr is not None:
        table.add_row("all boxes", frames, f"{evaluation.box_psnr:.2f}", "")
    return table
