"""The vehicles of a generation study: each made by one model from one image, placed, and kept.

FOLDER/cell.json      scores of every view, or why there is none
FOLDER/features.npz   (V, D) float32 by name of the features
FOLDER/strip.png      the views side by side
"""

from __future__ import annotations

import shutil
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from PIL import Image as PilImage

from recast.actors import ActorGenerator, Asset, Observation, make_generator
from recast.actors.generate import generated
from recast.actors.icp import FitSurface, bounds
from recast.actors.place import place_asset, stood_up
from recast.arrays import Array, Image
from recast.core.errors import InputError
from recast.core.files import atomic_folder, read_json, write_json
from recast.core.images import decode_image, rgb
from recast.core.table_files import read_npz
from recast.core.workers import in_this_process, worker_pool
from recast.geometry import se3
from recast.metrics.actor_scores import (
    ActorCase,
    ScoredCutout,
    case_observation,
    drawn,
    elevation_deg,
    framed,
    photographed,
    score_view,
)
from recast.metrics.perceptual import Embedder, ImageDistance, load_distances, load_embedders
from recast.metrics.table import rounded
from recast.recar.perturb import PerturbationConfig, perturb
from recast.splats import Gaussians
from recast.studies.generation.rows import VIEWS, StudyModel, read_views, vehicle_file
from recast.studies.sheets import strip, tile, tile_window

Features = NDArray[np.float32]
Placement = Literal["views", "canonical"]
"""`views`: by the conditioning view, as `recast eval actor`; `canonical`: as the model says."""

_CELL, _FEATURES = "cell.json", "features.npz"
_MEMBERS = ("key", "id", "failure", "facts", "views", "scores")
"""Members of cell.json."""


@dataclass(frozen=True)
class StudyCell:
    """One vehicle.

    Attributes:
        key: hash of all that decides the contents; another one makes the cell stale.
        facts: facts about how it was made and placed, plain values.
        views: names of the views it was looked at in.
        scores: scores of each view, by key of `STUDY_COLUMNS`; none for the truth.
        features: (V, D) features of the views, by name of the features.
        failure: reason why it could not be made; then there are no views.
    """

    key: str
    id: str
    facts: Mapping[str, Any]
    views: tuple[str, ...] = ()
    scores: tuple[Mapping[str, float], ...] = ()
    features: Mapping[str, Features] = field(default_factory=dict)
    failure: str | None = None


def write_cell(folder: Path, cell: StudyCell, pictures: Mapping[str, Image]) -> None:
    """Write a cell in place of what was there, whole or not at all.

    Args:
        pictures: images (H, W, 3) uint8 by name of the file, without ending.

    Raises:
        InputError: the disk is full.
    """
    if folder.exists():
        shutil.rmtree(folder)
    with atomic_folder(folder) as partial:
        record = {name: getattr(cell, name) for name in _MEMBERS}
        for name, picture in pictures.items():
            PilImage.fromarray(picture).save(partial / f"{name}.png", format="PNG")
        with (partial / _FEATURES).open("wb") as stream:
            arrays: dict[str, Any] = dict(cell.features)
            np.savez(stream, **arrays)
        write_json(partial / _CELL, rounded(record))


def cell_is(folder: Path, key: str) -> bool:
    """Whether there is a cell of that key."""
    if not (folder / _CELL).is_file():
        return False
    record = read_json(folder / _CELL)
    return isinstance(record, dict) and record.get("key") == key


def read_cell(folder: Path) -> StudyCell:
    """Read what `write_cell` wrote; InputError if it is missing or broken."""
    record = read_json(folder / _CELL)
    mend = "delete it and run again"
    try:
        plain = {name: record[name] for name in _MEMBERS}
        plain |= {name: tuple(plain[name]) for name in ("views", "scores")}
    except (KeyError, TypeError) as error:
        raise InputError(folder, "cell", f"cannot be read ({error})", mend) from None
    return StudyCell(**plain, features=read_npz(folder / _FEATURES, mend))


def read_strip(folder: Path, name: str = "strip") -> Image:
    """An image (H, W, 3) of a cell; InputError if it is missing or broken."""
    path = folder / f"{name}.png"
    mend = "delete its folder and run again"
    return rgb(decode_image(path, path, ("PNG",), mend=mend))


def place(
    asset: Asset, size: ArrayLike, observations: Sequence[Observation], how: Placement
) -> tuple[Gaussians, dict[str, Any]]:
    """Gaussians in the actor frame, and plain facts on how they were placed.

    Args:
        size: (3,) length, width, height of the box, metres.
        observations: conditioning views with cameras; only `views` looks at them.
        how: see `Placement`.

    Raises:
        InputError: see `stood_up`.
    """
    if how == "views":
        placed = place_asset(asset, size, observations)
        return placed.gaussians, {"by": how, **asdict(placed.report)}
    return place_canonical(asset, size)


def place_canonical(asset: Asset, size: ArrayLike) -> tuple[Gaussians, dict[str, Any]]:
    """Believe the forward axis of the asset's convention; nothing is searched.

    Scaled so that its length is the box's, centred, and stood on the box's floor. It ends where
    its outermost Gaussians cover half, which is where masks end. For models that were trained to
    look along +x whatever they are shown: errors of a search do not blur the comparison then.

    Raises:
        InputError: see `stood_up`.
    """
    size = np.asarray(size, np.float64)
    gaussians, surface = stood_up(asset)
    low, high = _outline(gaussians, surface)
    scale = float(size[0] / (high[0] - low[0]))
    middle = (low + high) / 2 * scale
    shift = np.array([-middle[0], -middle[1], -size[2] / 2 - low[2] * scale])
    extent = (high - low) * scale
    facts = {
        "by": "canonical",
        "axes": asset.axes.name,
        "scale": scale,
        "width_over_box": float(extent[1] / size[1]),
        "height_over_box": float(extent[2] / size[2]),
    }
    matrix = se3.from_rotation_translation(np.eye(3), shift)
    return gaussians.transformed(torch.from_numpy(matrix), scale), facts


def _outline(gaussians: Gaussians, surface: FitSurface) -> tuple[Array, Array]:
    """Lower and upper corner (3,) of where outer Gaussians alone cover half; strays left out.

    A Gaussian of opacity o covers half at sqrt(2 ln(o / 0.5)) deviations.
    """
    chosen = gaussians.select(torch.from_numpy(surface.index))
    opacity = torch.sigmoid(chosen.logit_opacities).double().numpy()
    radius = np.sqrt(2 * np.log(np.maximum(opacity / 0.5, 1.0)))
    axes = se3.quat_to_matrix(chosen.quats.double().numpy())
    deviations = np.exp(chosen.log_scales.double().numpy())
    along = np.sqrt(np.einsum("nij,nj->ni", axes**2, deviations**2))
    reach = radius[:, None] * along
    return bounds(surface.points - reach)[0], bounds(surface.points + reach)[1]


_PERTURBATIONS = 1  # the stream of random numbers of what befalls an input, by seed and vehicle


@dataclass(frozen=True)
class Measures:
    """Weights that scores need; a score is left out where they are not given.

    Attributes:
        lpips: AlexNet or VGG-16 as torchvision saves them.
        clip, dino: folders of a CLIP and of a DINOv2 model.
        inception: the FID's network, or torchvision's Inception v3.
    """

    lpips: Path | None = None
    clip: Path | None = None
    dino: Path | None = None
    inception: Path | None = None


@dataclass(frozen=True)
class CellTask:
    """What is to be made of one vehicle.

    Attributes:
        key, folder: key and folder of the cell, see `StudyCell`.
        model: what makes it; None for the photographs.
        perturbed: what the input is put through; None for a clean one. Of the photographs' task:
            with what the perturbed input is shown.
    """

    case: ActorCase
    key: str
    folder: Path
    model: StudyModel | None
    perturbed: PerturbationConfig | None


class CellMaker:
    """Makes cells, one after the other; the model last used stays loaded.

    Args:
        measures: weights of the networks that views are scored by.
        placement: see `recast.studies.generation.cells`.

    Raises:
        InputError: weights that cannot be read.
    """

    def __init__(self, measures: Measures, seed: int, placement: Placement) -> None:
        self._distances: Sequence[ImageDistance] = load_distances(lpips=measures.lpips)
        self._embedders: Sequence[Embedder] = load_embedders(
            measures.clip, measures.dino, measures.inception
        )
        self._seed = seed
        self._placement = placement
        self._model: tuple[StudyModel, ActorGenerator] | None = None

    def __call__(self, task: CellTask) -> dict[str, float]:
        """Make and write a cell; gives the seconds it took, by what was done.

        Raises:
            InputError: the model cannot be loaded, a picture of the set is broken, the disk is
                full. That a model fails on a vehicle is no error: the cell says so.
        """
        if task.model is None:
            return self._photographs(task)
        if task.model.source.startswith(VIEWS):
            return self._pictured(task, task.model)
        if task.model.folder is None:
            self._generator(task.model)  # whose errors end the study
        return self._generated(task, task.model)

    def _generator(self, model: StudyModel, vehicle: str = "") -> ActorGenerator:
        if model.folder is not None:
            return make_generator(vehicle_file(model.folder, vehicle), model.axes)
        if self._model is None or self._model[0] != model:
            self._model = None  # first let go of the other one
            self._model = (model, make_generator(model.source, model.axes))
        return self._model[1]

    def _photographs(self, task: CellTask) -> dict[str, float]:
        start = time.perf_counter()
        case = task.case
        clean = photographed(case.inputs[0].load())
        window = tile_window(clean.mask)
        pictures = {"input": tile(clean, window)}
        applied: list[dict[str, Any]] = []
        if task.perturbed is not None:
            rgba, applied = perturbed_input(case, self._seed, task.perturbed)
            pictures["perturbed"] = tile(photographed(rgba), window)
        truths = [photographed(view.load()) for view in case.targets]
        pictures["strip"] = _strip(truths, truths)
        facts = {
            "input": case.inputs[0].name,
            "input_azimuth_deg": case.inputs[0].azimuth_deg,
            "azimuths_deg": [view.azimuth_deg for view in case.targets],
            "elevations_deg": [elevation_deg(view) for view in case.targets],
            "perturbations": applied,
        }
        features = self._features(truths, truths)
        views = tuple(view.name for view in case.targets)
        write_cell(
            task.folder, StudyCell(task.key, case.id, facts, views, features=features), pictures
        )
        return {"measure": time.perf_counter() - start}

    def _pictured(self, task: CellTask, model: StudyModel) -> dict[str, float]:
        """Seconds of judging pictures drawn elsewhere: nothing is made or placed here."""
        assert model.folder is not None
        start = time.perf_counter()
        try:
            shown = [photographed(rgba) for rgba in read_views(model.folder, task.case)]
        except InputError as error:
            return self._failed(task, error, start)
        facts = {"details": {"pictures": model.folder.name}, "placement": {"by": "pictures"}}
        self._write(task, facts, shown)
        return {"measure": time.perf_counter() - start}

    def _failed(self, task: CellTask, error: InputError, start: float) -> dict[str, float]:
        write_cell(task.folder, StudyCell(task.key, task.case.id, {}, failure=str(error)), {})
        return {"generate": time.perf_counter() - start}

    def _generated(self, task: CellTask, model: StudyModel) -> dict[str, float]:
        case = task.case
        clean = [case_observation(case, view) for view in case.inputs]
        seen = clean[0]
        if task.perturbed is not None:
            rgba, _ = perturbed_input(case, self._seed, task.perturbed)
            seen = case_observation(case, case.inputs[0], rgba)
        start = time.perf_counter()
        try:
            asset = generated(self._generator(model, case.id), seen, self._seed)
            made = time.perf_counter()
            # by clean views: how well the silhouette is found again is not the model's doing
            gaussians, placement = place(asset, case.size, clean, self._placement)
        except InputError as error:
            return self._failed(task, error, start)
        placed = time.perf_counter()
        shown = [drawn(gaussians, asset.low_pass, view) for view in case.targets]
        facts = {
            "details": dict(asset.details),
            "seed": asset.seed,
            "placement": placement,
            "low_pass": asdict(asset.low_pass),
        }
        self._write(task, facts, shown)
        return {
            "generate": made - start,
            "place": placed - made,
            "measure": time.perf_counter() - placed,
        }

    def _write(self, task: CellTask, facts: dict[str, Any], shown: Sequence[ScoredCutout]) -> None:
        """Compare a vehicle's views with the photographs, and write its cell."""
        targets = task.case.targets
        truths = [photographed(view.load()) for view in targets]
        scores = [
            score_view(one, truth, self._distances)
            for one, truth in zip(shown, truths, strict=True)
        ]
        views = tuple(view.name for view in targets)
        features = self._features(shown, truths)
        cell = StudyCell(task.key, task.case.id, facts, views, tuple(scores), features)
        write_cell(task.folder, cell, {"strip": _strip(shown, truths)})

    def _features(
        self, shown: Sequence[ScoredCutout], truths: Sequence[ScoredCutout]
    ) -> dict[str, Features]:
        """Features of every view, seen in the square around the photographed vehicle."""
        squares = [one.within(framed(truth.mask)) for one, truth in zip(shown, truths, strict=True)]
        return {
            embedder.key: np.stack([embedder.features(one) for one in squares]).astype(np.float32)
            for embedder in self._embedders
        }


def perturbed_input(
    case: ActorCase, seed: int, config: PerturbationConfig
) -> tuple[Image, list[dict[str, Any]]]:
    """The input as every model gets it: by seed and vehicle, never clean.

    Returns:
        (H, W, 4) uint8, and what was applied, by name and severity.
    """
    rng = np.random.default_rng([seed, zlib.crc32(case.id.encode()), _PERTURBATIONS])
    never_clean = config.model_copy(update={"rho_clean": 0.0})
    result = perturb(case.inputs[0].load(), never_clean, rng)
    return result.rgba, [{"name": name, "severity": how} for name, how in result.applied]


def _strip(shown: Sequence[ScoredCutout], truths: Sequence[ScoredCutout]) -> Image:
    return strip(shown, [tile_window(truth.mask) for truth in truths])


OnDone = Callable[[CellTask, dict[str, float]], None]
"""Called with every task that is done and the seconds it took."""


def make_cells(
    tasks: Sequence[CellTask],
    measures: Measures,
    seed: int,
    placement: Placement,
    workers: int,
    on_done: OnDone,
) -> None:
    """Make and write all cells; the files are the same bytes for any number of workers.

    Args:
        tasks: those of one model in a row, since every process keeps just one loaded.
        measures, seed, placement: see `CellMaker`.
        workers: number of processes; with one, all is done in this process.
        on_done: function that is called after each task, in the order in which they end.

    Raises:
        InputError: see `CellMaker`, or a process was killed. Finished cells stay.
    """
    pool = in_this_process if len(tasks) < 2 else worker_pool(min(workers, len(tasks)))
    left, plan = iter(tasks), (measures, seed, placement)
    for task, took in pool(_start_maker, plan, lambda: next(left, None), "finished vehicles"):
        on_done(task, took)


def _start_maker(
    number: int, measures: Measures, seed: int, placement: Placement
) -> Callable[[CellTask], dict[str, float]]:
    del number
    return CellMaker(measures, seed, placement)
