"""`train_scene`: from a driving log to a scene folder, resumable at any moment."""

from __future__ import annotations

import shutil
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from recast.core.errors import InputError
from recast.core.files import alone_in, read_json, write_json
from recast.core.records import read_record
from recast.core.workers import usable_cores
from recast.logs import DrivingLog
from recast.scene.bodies import read_bodies
from recast.scene.checkpoint import (
    load_checkpoint,
    load_initialisation,
    save_checkpoint,
    save_initialisation,
)
from recast.scene.config import SceneConfig
from recast.scene.dynamic import choose_actors
from recast.scene.evaluate import held_out_psnr
from recast.scene.initialise import (
    BUDGET_FILE,
    BUDGET_VERSION,
    Budget,
    Initialisation,
    gaussian_budget,
    initialise,
)
from recast.scene.run import ProgressCallback, TrainingStatus, claim_folder
from recast.scene.store import SCENE_FILE, load_scene, save_scene
from recast.scene.street_scene import StreetScene
from recast.scene.trainer import Trainer
from recast.scene.views import TrainingView, read_views
from recast.splats import pick_device, set_threads

WORK_FOLDER = "work"
HISTORY_FILE = "history.json"
REPORT_EVERY = 10


@dataclass(frozen=True)
class TrainResult:
    """What a training run made.

    Attributes:
        scene: the scene, also at `folder`.
        history: one record an evaluation: iteration, gaussians, loss, psnr, held_out_psnr (dB).
        budget: how many Gaussians there might be, and whether that kept any from being added.
    """

    scene: StreetScene
    folder: Path
    history: list[dict[str, float]]
    budget: Budget


def train_scene(
    log: DrivingLog,
    out: str | Path,
    config: SceneConfig | None = None,
    progress: ProgressCallback | None = None,
    device: str = "auto",
) -> TrainResult:
    """Reconstruct the street of a log into the folder `out`.

    Writes config.json and source.json first, keeps first scene and checkpoints under work/, and
    ends with the scene's files, scene.json last. Run again on the same folder it goes on from the
    last checkpoint, or only loads what is finished; on the CPU the bytes are those of an
    uninterrupted run with the same number of threads. On CUDA gradients are added in no fixed
    order, so that no two runs are the same.

    Args:
        progress: told every few steps how far training is; see `TrainingDisplay`.
        device: device to train on, see `recast.splats.pick_device`; a run may go on on another one.

    Raises:
        InputError: the folder holds another run, the log lacks what is needed, the disk is full,
            there is no such device, or another process is at work in the folder.
    """
    config = config or SceneConfig()
    out = Path(out)
    place = pick_device(device)
    claim_folder(out, log, config)
    with alone_in(out):
        return _trained(log, out, config, place, progress or (lambda status: None))


def _trained(
    log: DrivingLog, out: Path, config: SceneConfig, place: torch.device, progress: ProgressCallback
) -> TrainResult:
    if (out / SCENE_FILE).is_file():
        shutil.rmtree(out / WORK_FOLDER, ignore_errors=True)  # a kill may have been faster
        mend = "train the scene again"
        budget = read_record(out / BUDGET_FILE, Budget, BUDGET_VERSION, mend)
        return TrainResult(load_scene(out), out, read_json(out / HISTORY_FILE), budget)
    threads = config.threads or usable_cores()
    run = _Run(log, out, config, threads, place, progress)
    before = torch.get_num_threads(), cv2.getNumThreads(), torch.backends.cudnn.allow_tf32
    try:
        # The rasterizer and the losses bring their own threads; torch's and OpenCV's would spin
        # against them for tensors that one core handles in microseconds.
        torch.set_num_threads(1)
        cv2.setNumThreads(1)
        # SSIM takes variances as differences of blurs: ten bits of mantissa leave little of them.
        torch.backends.cudnn.allow_tf32 = False
        set_threads(threads)
        return run.finish()
    finally:
        torch.set_num_threads(before[0])
        cv2.setNumThreads(before[1])
        torch.backends.cudnn.allow_tf32 = before[2]


class _Run:
    def __init__(
        self,
        log: DrivingLog,
        out: Path,
        config: SceneConfig,
        threads: int,
        device: torch.device,
        progress: ProgressCallback,
    ) -> None:
        self._log, self._out, self._config = log, out, config
        self._progress, self._threads, self._device = progress, threads, device
        self._work = out / WORK_FOLDER
        self._recent: deque[tuple[float, float]] = deque(maxlen=100)
        self._clock: deque[tuple[int, float]] = deque(maxlen=20)

    def finish(self) -> TrainResult:
        """Train to the end and write the scene."""
        self._tell("initialise", 0, None, [])
        views = read_views(self._log, self._config)
        held_out = [view for view in views if view.held_out]
        if len(held_out) == len(views):
            raise InputError(
                self._log.name, "cameras", "leave no image to train on", "check holdout_every"
            )
        budget = gaussian_budget(self._config, views)
        self._config = self._config.model_copy(update={"max_gaussians": budget.most_gaussians})
        start, trainer = self._trainer(views)
        checkpoint = self._work / "checkpoint.safetensors"
        history: list[dict[str, float]] = []
        if checkpoint.is_file():
            notes = load_checkpoint(trainer, checkpoint)
            history = notes["history"]
            self._recent.extend((loss, psnr) for loss, psnr in notes["recent"])
        config = self._config
        while trainer.iteration < config.iterations:
            report = trainer.step()
            self._recent.append((report.loss, report.psnr))
            last = trainer.iteration == config.iterations
            if trainer.iteration % REPORT_EVERY == 0 or last:
                self._tell("train", trainer.iteration, trainer, history)
            if trainer.iteration % config.evaluate_every == 0 or last:
                self._tell("evaluate", trainer.iteration, trainer, history)
                history.append(self._evaluate(trainer, held_out))
                self._clock.clear()
            if trainer.iteration % config.checkpoint_every == 0 and not last:
                notes = {"history": history, "recent": list(self._recent)}
                save_checkpoint(trainer, notes, checkpoint)
        scene = trainer.scene(self._log)
        budget = budget.model_copy(
            update={
                "first_found": start.found,
                "first_kept": len(start),
                "limited_from": trainer.limited_from,
                "limited_changes": trainer.limited_changes,
            }
        )
        write_json(self._out / BUDGET_FILE, budget.model_dump(mode="json"))
        write_json(self._out / HISTORY_FILE, history)
        save_scene(scene, self._out)
        shutil.rmtree(self._work, ignore_errors=True)
        self._tell("done", trainer.iteration, trainer, history)
        return TrainResult(scene, self._out, history, budget)

    def _trainer(self, views: list[TrainingView]) -> tuple[Initialisation, Trainer]:
        config = self._config
        tracks = choose_actors(self._log, views, config)
        bodies = read_bodies(config, tracks)
        path = self._work / "initialisation.safetensors"
        if path.is_file():
            start = load_initialisation(path)
        else:
            rng = np.random.default_rng(config.seed)
            start = initialise(self._log, views, tracks, config, rng, self._threads, bodies)
            save_initialisation(start, path)
        trainer = Trainer(config, views, tracks, start, self._device, bodies)
        return start, trainer

    def _evaluate(self, trainer: Trainer, held_out: list[TrainingView]) -> dict[str, float]:
        losses, psnrs = zip(*self._recent, strict=True)
        record = {
            "iteration": trainer.iteration,
            "gaussians": trainer.model.count_rows(),
            "loss": float(np.mean(losses)),
            "psnr": float(np.mean(psnrs)),
        }
        if held_out:
            record["held_out_psnr"] = held_out_psnr(trainer.scene(self._log), held_out)
        return record

    def _tell(
        self, phase: str, iteration: int, trainer: Trainer | None, history: list[dict[str, float]]
    ) -> None:
        config = self._config
        rate = left = None
        if phase == "train":
            self._clock.append((iteration, time.monotonic()))
            (first, start), (last, now) = self._clock[0], self._clock[-1]
            if now > start:
                rate = (last - first) / (now - start)
                left = (config.iterations - iteration) / rate
        self._progress(
            TrainingStatus(
                phase=phase,
                iteration=iteration,
                iterations=config.iterations,
                gaussians=trainer.model.count_rows() if trainer else 0,
                most_gaussians=config.max_gaussians if trainer else None,
                limited=trainer is not None and trainer.limited_changes > 0,
                loss=float(np.mean([loss for loss, _ in self._recent])) if self._recent else None,
                psnr=float(np.mean([psnr for _, psnr in self._recent])) if self._recent else None,
                held_out_psnr=history[-1].get("held_out_psnr") if history else None,
                iterations_per_second=rate,
                seconds_left=left,
            )
        )
