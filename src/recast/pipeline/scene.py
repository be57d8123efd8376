"""Training and judging a scene with a display for the terminal."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from rich.console import Console

from recast.evaluation.perceptual import load_distances
from recast.logs import DrivingLog
from recast.pipeline.display import FrameProgress
from recast.pipeline.scene_tables import evaluation_table, shift_table
from recast.pipeline.scene_truth import ShiftedTruth
from recast.scene import (
    SHIFTS,
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
from recast.synthetic import is_synthetic, world_of


def train_with_display(
    log: DrivingLog,
    out: str | Path,
    config: SceneConfig,
    console: Console | None = None,
    device: str = "auto",
) -> TrainResult:
    """Train a scene, or go on with one, while showing progress and time left.

    Says at the end how many Gaussians there might be, and whether that limit was met.
    """
    console = console or Console()
    with TrainingDisplay(console) as display:
        result = train_scene(log, out, config, progress=display, device=device)
    console.print(result.budget.explain(), markup=False)
    return result


def evaluate_and_print(
    scene: str | Path,
    log: DrivingLog,
    out: str | Path,
    console: Console | None = None,
    *,
    shifts: bool = False,
    lpips: Path | None = None,
    workers: int = 0,
) -> SceneEvaluation:
    """Score a scene's held-out images, write eval.json and pictures, print tables.

    A scene that another program trained is scored on the images that ours would keep by default.

    Args:
        shifts: also views from beside the drive, `recast.scene.SHIFTS`: against the truth where the
            log is synthetic, else as pictures alone.
        lpips: weights of the backbone, see `recast.evaluation.perceptual_lpips.load_lpips`.
        workers: processes that render the truth; 0 for one for each core.

    Raises:
        InputError: scene or weights are at fault, no image was held out, or another version of
            recast made the synthetic log.
    """
    console = console or Console()
    distances = load_distances(lpips=lpips)
    imported = (Path(scene) / IMPORT_FILE).is_file()
    config = SceneConfig() if imported else read_training_config(scene)
    loaded = load_scene(scene)
    with ExitStack() as stack:
        truth = None
        if shifts and is_synthetic(log):
            truth = stack.enter_context(ShiftedTruth(world_of(log), workers))
        progress = stack.enter_context(FrameProgress(console, 1, "views"))
        evaluation = evaluate_scene(
            loaded, log, config, out,
            lpips=distances[0] if distances else None,
            shifts=SHIFTS if shifts else (),
            truth=truth,
            progress=progress.reach,
        )  # fmt: skip
    console.print(evaluation_table(evaluation))
    if evaluation.shift_truth:
        console.print(shift_table(evaluation))
    elif evaluation.shifts:
        console.print(
            "shifted views: nobody knows what they truly show, so they are pictures without figures"
        )
    console.print(f"pictures: {out}", markup=False)
    return evaluation
