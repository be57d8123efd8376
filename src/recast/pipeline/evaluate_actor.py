"""Judge a generator of actors: make each vehicle from one picture, compare with reserved ones."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from PIL import Image
from rich.table import Table

from recast.actors import ActorGenerator, Observation
from recast.actors.observe import observation_of_view
from recast.actors.place import PlacementReport, place_asset
from recast.core.errors import InputError
from recast.core.files import atomic_folder, write_json
from recast.core.progress import Progress
from recast.evaluation.actor_scores import (
    ACTOR_COLUMNS,
    drawn,
    mean_scores,
    photographed,
    score_view,
)
from recast.evaluation.cases import ActorCase, ActorView, read_cases
from recast.evaluation.perceptual import ImageDistance
from recast.evaluation.sheets import ComparedView, comparison_sheet
from recast.evaluation.table import rounded

METRICS_FILE, TIMINGS_FILE = "metrics.json", "timings.json"


@dataclass(frozen=True)
class ViewResult:
    """Scores of one reserved view, by key of `ACTOR_COLUMNS`."""

    name: str
    azimuth_deg: float
    scores: dict[str, float]


@dataclass(frozen=True)
class VehicleResult:
    """One vehicle.

    Attributes:
        id: of the vehicle.
        input: name of the picture that it was made from, and `input_azimuth_deg` whence.
        further: names of other pictures that it was made from.
        details: the asset's own facts.
        placement: how it was placed.
        views: of the reserved cameras.
        mean: of every score over the views.
    """

    id: str
    input: str
    input_azimuth_deg: float
    further: tuple[str, ...]
    details: dict[str, str | float | int]
    placement: PlacementReport
    views: tuple[ViewResult, ...]
    mean: dict[str, float]


@dataclass(frozen=True)
class ActorEvaluation:
    """What a run over a set found.

    Attributes:
        generator, seed: what made the vehicles.
        vehicles: that were made.
        failures: by id, why one could not be made.
        mean: of every score over the vehicles, each counting the same.
    """

    generator: str
    seed: int
    vehicles: tuple[VehicleResult, ...]
    failures: dict[str, str]
    mean: dict[str, float]

    def to_json(self) -> dict[str, Any]:
        """Plain data, rounded to six decimals."""
        data: dict[str, Any] = rounded({"version": 1, **asdict(self)})
        return data


def evaluate_actors(
    generator: ActorGenerator,
    folder: Path,
    out: Path,
    *,
    seed: int = 0,
    limit: int | None = None,
    views: int = 1,
    distances: Sequence[ImageDistance] = (),
    progress: Progress | None = None,
) -> ActorEvaluation:
    """Make every vehicle of a set, place it, and compare it with its reserved views.

    Writes `metrics.json`, the same for the same seed, `timings.json`, and `ID.png` of every
    vehicle to `out`, whole or not at all. A vehicle that cannot be made is recorded and left out
    of the means.

    Args:
        generator: what is judged.
        folder: real crops or a vehicle set, see `read_cases`.
        out: to be made.
        seed: of the generator, and of the choice of input views.
        limit: judge only the first vehicles.
        views: input views that a vehicle is made from, at most.
        distances: further measures.
        progress: told the number of vehicles done, and of all.

    Raises:
        InputError: the set is at fault, no vehicle could be made, or `out` exists.
    """
    cases = read_cases(folder, seed, limit, views)
    results, failures, seconds = [], {}, {}
    with atomic_folder(out) as partial:
        for index, case in enumerate(cases):
            observations = [_observation(case, view) for view in case.inputs]
            start = time.perf_counter()
            try:
                first = replace(observations[0], further=tuple(observations[1:views]))
                asset = generator.generate(first, seed)
                made = time.perf_counter()
                placed = place_asset(asset, case.size, observations)
            except InputError as error:
                if len(cases) == 1:
                    raise
                failures[case.id] = str(error)
                continue
            finally:
                if progress is not None:
                    progress(index + 1, len(cases))
            seconds[case.id] = {"generate": made - start, "place": time.perf_counter() - made}
            judged, compared = [], []
            for view in case.targets:
                truth, shown = (
                    photographed(view.load()),
                    drawn(placed.gaussians, asset.low_pass, view),
                )
                scores = score_view(shown, truth, distances)
                judged.append(ViewResult(view.name, view.azimuth_deg, scores))
                compared.append(ComparedView(_caption(view, scores), truth, shown))
            source = case.inputs[0]
            sheet = comparison_sheet(
                f"{source.name}, azimuth {source.azimuth_deg:.0f}",
                photographed(source.load()),
                compared,
            )
            Image.fromarray(sheet).save(partial / f"{case.id}.png", format="PNG")
            results.append(
                VehicleResult(
                    case.id,
                    source.name,
                    source.azimuth_deg,
                    tuple(view.name for view in case.inputs[1:views]),
                    dict(asset.details),
                    placed.report,
                    tuple(judged),
                    mean_scores([view.scores for view in judged]),
                )
            )
        if not results:
            raise InputError(
                folder,
                "vehicles",
                f"none could be made; {case.id}: {failures[case.id]}",
                "see that the generator fits these pictures",
            )
        mean = mean_scores([one.mean for one in results])
        evaluation = ActorEvaluation(generator.name, seed, tuple(results), failures, mean)
        write_json(partial / METRICS_FILE, evaluation.to_json())
        write_json(partial / TIMINGS_FILE, rounded(seconds))
    return evaluation


def evaluation_table(evaluation: ActorEvaluation) -> Table:
    """A line for every vehicle, and their mean."""
    table = Table(title=f"{evaluation.generator}, seed {evaluation.seed}")
    table.add_column("vehicle")
    table.add_column("views", justify="right")
    keys = [key for key in ACTOR_COLUMNS if key in evaluation.mean]
    for key in keys:
        column = ACTOR_COLUMNS[key]
        unit = f" {column.unit}" if column.unit else ""
        table.add_column(f"{column.label}{unit} {'↑' if column.higher else '↓'}", justify="right")
    rows = [(one.id, len(one.views), one.mean) for one in evaluation.vehicles]
    total = sum(views for _, views, _ in rows)
    for index, (name, views, scores) in enumerate([*rows, ("mean", total, evaluation.mean)]):
        cells = [ACTOR_COLUMNS[key].shown(scores[key]) for key in keys]
        table.add_row(name, str(views), *cells, end_section=index == len(rows) - 1)
    return table


def _observation(case: ActorCase, view: ActorView) -> Observation:
    return observation_of_view(
        view.load(),
        view.camera,
        view.camera_from_actor,
        case.size,
        name=f"{case.id}/{view.name}",
        category=case.category,
    )


def _caption(view: ActorView, scores: dict[str, float]) -> str:
    decibels = f"PSNR {scores['psnr']:.1f} ({scores['psnr_vehicle']:.1f})"
    return (
        f"azimuth {view.azimuth_deg:.0f}\n"
        f"{decibels}  SSIM {scores['ssim']:.3f}  IoU {scores['mask_iou']:.2f}"
    )
