"""`train_scene`: from a driving log to a scene folder, resumable at any moment."""

from __future__ import annotations

import shutil
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from pydantic import ValidationError
from torch import Tensor

from recast.core.errors import InputError
from recast.core.files import alone_in, partial_name, read_json, write_json
from recast.core.records import Record, read_record
from recast.core.workers import usable_cores
from recast.logs import DrivingLog, GroundHeight
from recast.reconstruction.bodies import read_bodies
from recast.reconstruction.config import SceneConfig, parse_config, write_config
from recast.reconstruction.densify import BUDGET_FILE, BUDGET_VERSION, Budget, gaussian_budget, rows
from recast.reconstruction.evaluate import held_out_psnr
from recast.reconstruction.first_points import Initialisation, initialise
from recast.reconstruction.step import STATES, Trainer
from recast.reconstruction.tables import make_sky
from recast.reconstruction.views import DepthSamples, TrainingView, choose_actors, read_views
from recast.scene.sky import SkyMap
from recast.scene.store import (
    SCENE_FILE,
    load_scene,
    log_fingerprint,
    read_tensors,
    write_tensors,
)
from recast.scene.street_scene import SceneActor, StreetScene
from recast.splats import Gaussians, pick_device, set_threads

WORK_FOLDER = "work"
CHECKPOINT = f"{WORK_FOLDER}/checkpoint.safetensors"
FIRST_SCENE = f"{WORK_FOLDER}/initialisation.safetensors"
HISTORY_FILE = "history.json"
REPORT_EVERY = 10
CONFIG_FILE = "config.json"
SOURCE_FILE = "source.json"
FREE_FIELDS = frozenset({"threads", "evaluate_every", "checkpoint_every"})
"""Fields that may differ when a run is taken up again: they do not change what is learned."""


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
        if (out / SCENE_FILE).is_file():
            shutil.rmtree(out / WORK_FOLDER, ignore_errors=True)  # a kill may have been faster
            mend = "train the scene again"
            budget = read_record(out / BUDGET_FILE, Budget, BUDGET_VERSION, mend)
            return TrainResult(load_scene(out), out, read_json(out / HISTORY_FILE), budget)
        threads = config.threads or usable_cores()
        with _threads_for_kernels(threads):
            return _Run(
                log, out, config, threads, place, progress or (lambda status: None)
            ).finish()


@contextmanager
def _threads_for_kernels(threads: int) -> Iterator[None]:
    """The rasterizer and the losses bring their own threads; torch's and OpenCV's would spin
    against them for tensors that one core handles in microseconds."""
    before = torch.get_num_threads(), cv2.getNumThreads(), torch.backends.cudnn.allow_tf32
    try:
        torch.set_num_threads(1)
        cv2.setNumThreads(1)
        # SSIM takes variances as differences of blurs: ten bits of mantissa leave little of them.
        torch.backends.cudnn.allow_tf32 = False
        set_threads(threads)
        yield
    finally:
        torch.set_num_threads(before[0])
        cv2.setNumThreads(before[1])
        torch.backends.cudnn.allow_tf32 = before[2]


class _Run:
    """A training from its first step, or its last checkpoint, to the scene's files."""

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
        self._terms: Mapping[str, Tensor] = {}

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
        checkpoint = self._out / CHECKPOINT
        history: list[dict[str, float]] = []
        if checkpoint.is_file():
            notes = load_checkpoint(trainer, checkpoint)
            history = notes["history"]
            self._recent.extend((loss, psnr) for loss, psnr in notes["recent"])
        config = self._config
        while trainer.iteration < config.iterations:
            report = trainer.step()
            self._recent.append((report.loss, report.psnr))
            self._terms = report.terms
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
        scene = trainer.save(self._log, self._out)
        shutil.rmtree(self._work, ignore_errors=True)
        self._tell("done", trainer.iteration, trainer, history)
        return TrainResult(scene, self._out, history, budget)

    def _trainer(self, views: list[TrainingView]) -> tuple[Initialisation, Trainer]:
        config = self._config
        tracks = choose_actors(self._log, views, config)
        bodies = read_bodies(config, tracks)
        path = self._out / FIRST_SCENE
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
            done = trainer.iteration >= self._config.iterations
            scene = trainer.finished(self._log) if done else trainer.scene(self._log)
            record["held_out_psnr"] = held_out_psnr(scene, held_out)
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
                terms={name: float(term) for name, term in self._terms.items()},
                held_out_psnr=history[-1].get("held_out_psnr") if history else None,
                iterations_per_second=rate,
                seconds_left=left,
            )
        )


class TrainingSource(Record):
    """Contents of source.json: the log a scene is made from."""

    log_name: str
    log_fingerprint: str


def claim_folder(folder: Path, log: DrivingLog, config: SceneConfig) -> None:
    """Make `folder` this run's, or check that it is already.

    Raises:
        InputError: it holds something else, or a run with another log, configuration or version.
    """
    source = TrainingSource(log_name=log.name, log_fingerprint=log_fingerprint(log))
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "output folder", "is a file", "name another folder")
    if (folder / CONFIG_FILE).is_file() and (folder / SOURCE_FILE).is_file():
        _check_same(folder, source, config)
        return
    strangers = [] if not folder.exists() else sorted(folder.iterdir())
    begun = {
        partial_name(name).name for name in (CONFIG_FILE, SOURCE_FILE)
    }  # left behind by a kill
    ours = {CONFIG_FILE, SOURCE_FILE, *begun}
    strangers = [path for path in strangers if path.name not in ours]
    if strangers:
        raise InputError(
            folder,
            "output folder",
            f"holds something that is not a scene ({strangers[0].name})",
            "name another folder or remove this one",
        )
    write_json(folder / SOURCE_FILE, source.model_dump())
    write_config(config, folder / CONFIG_FILE)


def read_training_config(folder: str | Path) -> SceneConfig:
    """The configuration that a scene folder was trained with.

    Raises:
        InputError: missing, broken or of another version.
    """
    path = Path(folder) / CONFIG_FILE
    return parse_config(path, read_json(path))


def require_log_of(folder: str | Path, log: DrivingLog) -> None:
    """Refuse a scene folder that was trained on a log of another name; an imported one does not
    say what it was trained on.

    Raises:
        InputError: it was.
    """
    path = Path(folder) / SOURCE_FILE
    if path.is_file():
        source = read_json(path)
        name = source.get("log_name") if isinstance(source, dict) else None
        if name != log.name:
            problem = f"was trained on {name}, and the log is {log.name}"
            raise InputError(folder, "scene", problem, "name a scene of this log")


def _check_same(folder: Path, source: TrainingSource, config: SceneConfig) -> None:
    mend = "name another folder or remove this one"
    found = read_training_config(folder)
    if not found.is_whole():
        problem = "were written by an earlier release with another recipe"
        raise InputError(folder / CONFIG_FILE, "fields", problem, mend)
    for name in SceneConfig.model_fields:
        before, asked = getattr(found, name), getattr(config, name)
        if name not in FREE_FIELDS and before != asked:
            raise InputError(
                folder, name, f"holds a run with {before!r}, this one has {asked!r}", mend
            )
    try:
        before = TrainingSource.model_validate(read_json(folder / SOURCE_FILE))
    except ValidationError:
        raise InputError(folder / SOURCE_FILE, "source", "cannot be read", mend) from None
    if before != source:
        raise InputError(
            folder,
            "log",
            f"holds a run of {before.log_name}"
            + (" in another state" if before.log_name == source.log_name else ""),
            mend,
        )


@dataclass(frozen=True)
class TrainingStatus:
    """A moment of a training run.

    Attributes:
        phase: what is being done: "initialise", "train", "evaluate", "done".
        iteration, iterations: steps done, and of how many.
        gaussians: number of Gaussians.
        most_gaussians: limit of Gaussians; None before it is known.
        limited: whether the limit kept any from being added.
        loss, psnr: running means over the latest training views; None before the first.
        terms: weighted terms of the loss of the latest view, by name.
        held_out_psnr: PSNR of the last periodic evaluation in dB; None before the first.
        iterations_per_second: rate over the latest steps.
        seconds_left: estimate to the end of training.
    """

    phase: str
    iteration: int
    iterations: int
    gaussians: int = 0
    most_gaussians: int | None = None
    limited: bool = False
    loss: float | None = None
    psnr: float | None = None
    terms: Mapping[str, float] = field(default_factory=dict)
    held_out_psnr: float | None = None
    iterations_per_second: float | None = None
    seconds_left: float | None = None


ProgressCallback = Callable[[TrainingStatus], None]


def save_checkpoint(trainer: Trainer, notes: Mapping[str, Any], path: Path) -> None:
    """Write parameters, optimiser states, statistics and the iteration, atomically.

    `notes` are the caller's own, JSON-able, and come back from `load_checkpoint`.

    Random numbers need no state: each is drawn from a generator seeded by seed and iteration.
    """
    model = trainer.model
    tensors: dict[str, Tensor] = {"owner": model.owner}
    if model.fourier.shape[1]:
        tensors["waves"] = model.fourier
    tensors |= _prefixed("background", rows(model.background))
    tensors |= _prefixed("local", rows(model.local))
    for name, table in trainer.tables().items():
        tensors |= _prefixed(name, table.state_dict())
    for name in STATES:
        tensors |= _prefixed(name, getattr(model, name).state_dict())
    header = {
        "iteration": trainer.iteration,
        "limited_from": trainer.limited_from,
        "limited_changes": trainer.limited_changes,
        "notes": notes,
    }
    write_tensors(path, tensors, header)


def load_checkpoint(trainer: Trainer, path: Path) -> dict[str, Any]:
    """Put a fresh trainer of the same run where the checkpoint left off; returns the notes.

    Raises:
        InputError: the file is missing or broken.
    """
    with _broken(path):
        tensors, header = read_tensors(path)
        model = trainer.model
        local = Gaussians(**_group(tensors, "local"))
        model.place(
            Gaussians(**_group(tensors, "background")).to(trainer.device),
            local.to(trainer.device),
            tensors["owner"],
            tensors.get("waves", torch.zeros(len(local), 0, 3)).to(trainer.device),
        )
        model.restore({name: _group(tensors, name) for name in STATES})
        for name, table in trainer.tables().items():
            table.load_state_dict(_group(tensors, name))
        trainer.iteration = int(header["iteration"])
        trainer.limited_from = header["limited_from"]
        trainer.limited_changes = int(header["limited_changes"])
        return dict(header["notes"])


def save_initialisation(start: Initialisation, path: Path) -> None:
    """Keep the first scene, so that a run taken up again need not build it anew."""
    tensors = _prefixed("background", rows(start.background)) | {"sky": start.sky.colours}
    for track_id, part in start.actors.items():
        tensors |= _prefixed(f"actor/{track_id}", rows(part))
    for index, (sky, depths) in enumerate(zip(start.sky_pixels, start.depths, strict=True)):
        tensors[f"view/{index}/sky"] = torch.from_numpy(sky)
        tensors[f"view/{index}/depths"] = torch.from_numpy(depths.depths)
        tensors[f"view/{index}/uv"] = torch.from_numpy(depths.uv)
    header: dict[str, Any] = {
        "actors": list(start.actors),
        "views": len(start.depths),
        "found": start.found,
    }
    if start.ground is not None:
        tensors["ground:origin"] = torch.from_numpy(start.ground.origin)
        tensors["ground:height"] = torch.from_numpy(start.ground.height)
        header["ground_cell_m"] = start.ground.cell
    write_tensors(path, tensors, header)


def load_initialisation(path: Path) -> Initialisation:
    """Read `save_initialisation`'s file; InputError if the file is missing or broken."""
    with _broken(path):
        tensors, header = read_tensors(path)
        views = range(header["views"])
        ground = None
        if "ground_cell_m" in header:
            part = _group(tensors, "ground")
            ground = GroundHeight(
                part["origin"].numpy(), header["ground_cell_m"], part["height"].numpy()
            )
        start = Initialisation(
            background=Gaussians(**_group(tensors, "background")),
            actors={
                name: Gaussians(**_group(tensors, f"actor/{name}")) for name in header["actors"]
            },
            sky=SkyMap(tensors["sky"]),
            sky_pixels=[tensors[f"view/{i}/sky"].numpy().astype(np.int64) for i in views],
            depths=[
                DepthSamples(tensors[f"view/{i}/depths"].numpy(), tensors[f"view/{i}/uv"].numpy())
                for i in views
            ],
            ground=ground,
            found=header["found"],
        )
        for gaussians in (start.background, *start.actors.values()):
            gaussians.validate()
    return start


def load_preview(folder: Path, log: DrivingLog) -> tuple[StreetScene, int]:
    """The street of a training that goes on, as of its last checkpoint, and that step.

    To look at: its actors are rigid and stand where the log has them, its colours are those of no
    exposure, and surfaces that no image shows are not marked.

    Args:
        folder: folder that `train_scene` is writing.

    Raises:
        InputError: there is no checkpoint yet, or no more.
    """
    config = read_training_config(folder)
    start, path = load_initialisation(folder / FIRST_SCENE), folder / CHECKPOINT
    with _broken(path):
        tensors, header = read_tensors(path)
        local, owner = Gaussians(**_group(tensors, "local")), tensors["owner"]
        sky = make_sky(config, start.sky)
        sky.table.load_state_dict(_group(tensors, "sky"))
        actors = {
            name: SceneActor(
                name,
                local.select((owner == index).nonzero()[:, 0]),
                log.tracks[name].size,
                log.tracks[name].trajectory,
                low_pass=config.low_pass,
            )
            for index, name in enumerate(start.actors)
        }
        scene = StreetScene(
            Gaussians(**_group(tensors, "background")),
            actors,
            sky.sky_map(),
            world_offset=log.world_offset,
            log_name=log.name,
            low_pass=config.low_pass,
        )
        return scene, int(header["iteration"])


@contextmanager
def _broken(path: Path) -> Iterator[None]:
    """What a file of ours lacks, or has of another kind or shape, is one clear line."""
    try:
        yield
    except InputError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        problem = f"is not a checkpoint of this version ({type(error).__name__}: {error})"
        raise InputError(path, "state", problem, "remove work/ and train again") from error


def _prefixed(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {f"{prefix}:{name}": tensor for name, tensor in tensors.items()}


def _group(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    start = f"{prefix}:"
    return {name[len(start) :]: t for name, t in tensors.items() if name.startswith(start)}
