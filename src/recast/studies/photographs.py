"""Judge vehicles by photographs that they were not made from.

One or several generators make the vehicles of one or several sets; every reserved view is compared
by parts, paint, sharpness and pixels. Views far from all inputs have means of their own: they show
what the generator made up.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PilImage
from rich.box import SIMPLE_HEAD
from rich.table import Table

from recast.actors import ActorGenerator, make_generator
from recast.actors.generate import generated
from recast.actors.place import PlacementReport, place_asset
from recast.arrays import Array, Image
from recast.core.diagnostics import Progress
from recast.core.errors import InputError
from recast.core.files import atomic_folder, write_json
from recast.metrics.actor_scores import (
    ACTOR_COLUMNS,
    ActorCase,
    ActorColumn,
    ActorView,
    ScoredCutout,
    case_observation,
    drawn,
    mean_scores,
    photographed,
    read_cases,
    score_view,
)
from recast.metrics.oracle_scores import light_gain, paint_distance, sharpness, structure_distance
from recast.metrics.part_checks import PartCheck, paint_colours, part_checks, passed_share
from recast.metrics.perceptual import ImageDistance
from recast.metrics.table import rounded
from recast.studies.generation.rows import VIEWS, read_views, view_paths
from recast.studies.sheets import ComparedView, comparison_sheet

METRICS_FILE, TIMINGS_FILE = "metrics.json", "timings.json"
FAR_DEG = 60.0
"""Degrees from every input view beyond which a view shows what no input does."""
PHOTOGRAPH_COLUMNS: Mapping[str, ActorColumn] = {
    "parts": ActorColumn("parts", "%", True, 0),
    "paint": ActorColumn("paint", "Lab", False, 1),
    "sharpness": ActorColumn("sharp", "", True, 2),
    "structure": ActorColumn("structure", "", False, 3),
    **ACTOR_COLUMNS,
}
"""Scores in the order of the table. `parts` is the share of the decided checks that passed."""


@dataclass(frozen=True)
class ViewResult:
    """Scores of one reserved view.

    Attributes:
        apart_deg: angle to the nearest input view that was used.
        scores: by key of `PHOTOGRAPH_COLUMNS`, without `parts`.
        checks: part checks of the sides that the view shows.
    """

    name: str
    azimuth_deg: float
    apart_deg: float
    scores: dict[str, float]
    checks: tuple[PartCheck, ...]


@dataclass(frozen=True)
class VehicleResult:
    """One vehicle.

    Attributes:
        input: name of the picture that it was made from.
        input_azimuth_deg: azimuth from which that picture was taken, degrees.
        further: names of other pictures that it was made from.
        placement: None if its views were drawn elsewhere.
        mean: means over all views; `far`: over those beyond `FAR_DEG`, empty if there are none.
    """

    id: str
    input: str
    input_azimuth_deg: float
    further: tuple[str, ...]
    details: dict[str, str | float | int]
    placement: PlacementReport | None
    views: tuple[ViewResult, ...]
    mean: dict[str, float]
    far: dict[str, float]


@dataclass(frozen=True)
class PhotographScores:
    """What one generator reached over all sets.

    Attributes:
        name: name in the table.
        generator: what made the vehicles.
        failures: reason why a vehicle could not be made, by its id.
        mean: means over the vehicles, each counting the same; `parts` over all checks.
        far: the same of the views beyond `FAR_DEG`.
        undecided: number of checks that the photographs do not decide.
    """

    name: str
    generator: str
    vehicles: tuple[VehicleResult, ...]
    failures: dict[str, str]
    mean: dict[str, float]
    far: dict[str, float]
    undecided: int


@dataclass(frozen=True)
class PhotographEvaluation:
    """What a run found; the first generator is the one that others are compared with."""

    seed: int
    generators: tuple[PhotographScores, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain data, rounded to six decimals."""
        return rounded({"version": 2, **asdict(self)})


def evaluate_photographs(
    generators: Mapping[str, ActorGenerator | str],
    folders: Sequence[Path],
    out: Path,
    *,
    seed: int = 0,
    limit: int | None = None,
    views: int = 1,
    distances: Sequence[ImageDistance] = (),
    progress: Progress | None = None,
) -> PhotographEvaluation:
    """Make every vehicle of the sets, place it, and compare it with its reserved views.

    Writes `metrics.json`, the same for the same seed, and `timings.json` to `out`, and for every
    generator a folder with `ID.png`, a sheet, and `ID/VIEW.png`, the renders (RGBA): a later run
    compares with them as `views:OUT/NAME`. All is written whole or not at all. A vehicle that
    cannot be made is recorded and left out of the means.

    Args:
        generators: generators by name, see `make_generator`; or "views:DIR", renders of an earlier
            run.
        folders: real crops or vehicle sets, see `read_cases`.
        seed: seed of the generators, and of the choice of input views.
        views: largest number of input views that a vehicle is made from.

    Raises:
        InputError: a set is at fault, two sets have a vehicle of one id, a generator could make no
            vehicle, or `out` exists.
    """
    cases = [case for folder in folders for case in read_cases(folder, seed, limit, views)]
    ids = [case.id for case in cases]
    twice = next((id for id in ids if ids.count(id) > 1), None)
    if twice is not None:
        raise InputError(
            twice, "id", "is in two sets", "rename a vehicle's folder, or leave it out"
        )
    resolved = {
        name: one if isinstance(one, str) and one.startswith(VIEWS) else make_generator(one)
        for name, one in generators.items()
    }
    results, seconds, done = [], {}, 0
    with atomic_folder(out) as partial:
        for name, generator in resolved.items():
            vehicles, failures, place = [], {}, partial / name
            place.mkdir()
            for case in cases:
                start = time.perf_counter()
                try:
                    vehicle, renders, sheet = _judged(case, generator, seed, views, distances)
                except InputError as error:
                    if len(cases) == 1:
                        raise
                    failures[case.id] = str(error)
                else:
                    vehicles.append(vehicle)
                    PilImage.fromarray(sheet).save(place / f"{case.id}.png", format="PNG")
                    for path, render in zip(view_paths(place, case), renders, strict=True):
                        path.parent.mkdir(exist_ok=True)
                        PilImage.fromarray(_straight(render)).save(path, format="PNG")
                seconds[f"{name}/{case.id}"] = time.perf_counter() - start
                done += 1
                if progress is not None:
                    progress(done, len(cases) * len(resolved))
            if not vehicles:
                raise InputError(
                    folders[0],
                    "vehicles",
                    f"none could be made; {ids[-1]}: {failures[ids[-1]]}",
                    "check that the generator fits these images",
                )
            made_by = generator if isinstance(generator, str) else generator.name
            results.append(_summary(name, made_by, vehicles, failures))
        evaluation = PhotographEvaluation(seed, tuple(results))
        write_json(partial / METRICS_FILE, evaluation.to_json())
        write_json(partial / TIMINGS_FILE, rounded(seconds))
    return evaluation


def _judged(
    case: ActorCase,
    generator: ActorGenerator | str,
    seed: int,
    views: int,
    distances: Sequence[ImageDistance],
) -> tuple[VehicleResult, list[ScoredCutout], Image]:
    """One vehicle of one generator: its scores, its renders, and its sheet."""
    inputs = case.inputs[:views]
    details: dict[str, str | float | int] = {}
    report = None
    if isinstance(generator, str):
        pictures = read_views(Path(generator.removeprefix(VIEWS)), case)
        renders = [photographed(rgba) for rgba in pictures]
    else:
        observations = [case_observation(case, view) for view in case.inputs]
        first = replace(observations[0], further=tuple(observations[1:views]))
        asset = generated(generator, first, seed)
        placed = place_asset(asset, case.size, observations)
        details, report = dict(asset.details), placed.report
        renders = [drawn(placed.gaussians, asset.low_pass, view) for view in case.targets]
    source = inputs[0].load()
    source_rgb, source_mask = source[..., :3] / 255.0, source[..., 3] > 127
    photographs = [view.load() for view in case.targets]
    truths = [photographed(rgba) for rgba in photographs]
    paints = zip(paint_colours(renders), paint_colours(truths), strict=True)
    judged, compared = [], []
    for view, shown, rgba, truth, paint in zip(
        case.targets, renders, photographs, truths, paints, strict=True
    ):
        gain = light_gain(source_rgb, source_mask, rgba[..., :3] / 255.0, rgba[..., 3] > 127)
        scores = {
            "paint": paint_distance(*paint, gain),
            "sharpness": sharpness(shown, truth),
            "structure": structure_distance(shown, truth),
            **score_view(shown, truth, distances),
        }
        checks = tuple(part_checks(shown, truth, view, case.size, paint))
        apart = min(_apart_deg(view, one) for one in inputs)
        result = ViewResult(view.name, view.azimuth_deg, apart, scores, checks)
        judged.append(result)
        compared.append(ComparedView(_caption(result), truth, shown))
    title = f"{inputs[0].name}, azimuth {inputs[0].azimuth_deg:.0f}"
    vehicle = VehicleResult(
        case.id,
        inputs[0].name,
        inputs[0].azimuth_deg,
        tuple(view.name for view in inputs[1:]),
        details,
        report,
        tuple(judged),
        _mean(judged),
        _mean(_far(judged)),
    )
    return vehicle, renders, comparison_sheet(title, photographed(source), compared)


def _apart_deg(one: ActorView, other: ActorView) -> float:
    """Angle between the directions from which two views look, in plan."""
    return abs((one.azimuth_deg - other.azimuth_deg + 180.0) % 360.0 - 180.0)


def _far(views: Sequence[ViewResult]) -> list[ViewResult]:
    return [view for view in views if view.apart_deg >= FAR_DEG]


def _mean(views: Sequence[ViewResult]) -> dict[str, float]:
    """Means over views; `parts` where a check is decided. Empty without views."""
    if not views:
        return {}
    return {**_parts(views), **mean_scores([view.scores for view in views])}


def _parts(views: Sequence[ViewResult]) -> dict[str, float]:
    """Share of the decided checks of all views that passed, in per cent; empty if none is."""
    passed, decided, _ = passed_share([check for view in views for check in view.checks])
    return {"parts": 100.0 * passed / decided} if decided else {}


def _summary(
    name: str, generator: str, vehicles: Sequence[VehicleResult], failures: dict[str, str]
) -> PhotographScores:
    means = []
    for views in ([v.views for v in vehicles], [_far(v.views) for v in vehicles]):
        # each vehicle counts the same, but a check is a check
        each = [mean_scores([view.scores for view in one]) for one in views if one]
        parts = _parts([view for one in views for view in one])
        means.append({**parts, **mean_scores(each)} if each else {})
    mean, far = means
    *_, undecided = passed_share([c for v in vehicles for view in v.views for c in view.checks])
    return PhotographScores(name, generator, tuple(vehicles), failures, mean, far, undecided)


def _straight(cutout: ScoredCutout) -> Image:
    """(H, W, 4) uint8 with straight alpha."""
    rgb: Array = cutout.rgb / np.maximum(cutout.alpha, 1e-6)[..., None]
    rgba = np.dstack([rgb.clip(0, 1), cutout.alpha])
    return (rgba * 255).round().astype(np.uint8)


def photographs_table(evaluation: PhotographEvaluation) -> Table:
    """Vehicles and means of every generator, and differences from the first one."""
    first = evaluation.generators[0]
    keys = [key for key in PHOTOGRAPH_COLUMNS if key in first.mean]
    title = f"reserved photographs, seed {evaluation.seed}"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("generator, vehicle")
    table.add_column("views", justify="right")
    for key in keys:
        column = PHOTOGRAPH_COLUMNS[key]
        unit = f" {column.unit}" if column.unit else ""
        table.add_column(f"{column.label}{unit} {'↑' if column.higher else '↓'}", justify="right")

    def row(name: str, views: int, scores: Mapping[str, float], end: bool = False) -> None:
        cells = [PHOTOGRAPH_COLUMNS[k].shown(scores[k]) if k in scores else "" for k in keys]
        table.add_row(name, str(views), *cells, end_section=end)

    for one in evaluation.generators:
        for vehicle in one.vehicles:
            row(f"{one.name}, {vehicle.id}", len(vehicle.views), vehicle.mean)
        far = sum(len(_far(vehicle.views)) for vehicle in one.vehicles)
        row(f"{one.name}, mean", sum(len(v.views) for v in one.vehicles), one.mean)
        row(f"{one.name}, beyond {FAR_DEG:.0f} degrees", far, one.far, one is first)
        if one is not first:
            for what, mine, base in (
                ("mean", one.mean, first.mean),
                ("beyond", one.far, first.far),
            ):
                apart = {key: mine[key] - base[key] for key in keys if key in mine and key in base}
                row(f"{one.name} - {first.name}, {what}", 0, apart, what == "beyond")
    return table


def _caption(view: ViewResult) -> str:
    """Where the view is from, its scores, and the checks that failed."""
    passed, decided, _ = passed_share(view.checks)
    failed = ", ".join(c.part for c in view.checks if c.passed is False)
    told = f" - {failed}" if failed else ""
    scores = view.scores
    return (
        f"azimuth {view.azimuth_deg:.0f}  parts {passed}/{decided}{told}\n"
        f"PSNR {scores['psnr_vehicle']:.1f}  IoU {scores['mask_iou']:.2f}  "
        f"paint {scores['paint']:.0f}  sharp {scores['sharpness']:.2f}"
    )
