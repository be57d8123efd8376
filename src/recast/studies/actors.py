"""Judge actors: by reserved pictures of the vehicles of a set, or by held-out images of a log."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL import Image as PilImage
from rich.box import SIMPLE_HEAD
from rich.table import Table

from recast.actors import Actor, ActorGenerator, insert, load_actor
from recast.actors.generate import generated
from recast.actors.insert import require_model
from recast.actors.place import PlacementReport, place_asset
from recast.core.errors import InputError
from recast.core.files import atomic_folder, write_json
from recast.core.progress import Progress
from recast.logs import DrivingLog
from recast.metrics.actor_scores import (
    ACTOR_COLUMNS,
    TrackView,
    drawn,
    held_out_track,
    mean_scores,
    photographed,
    score_view,
)
from recast.metrics.cases import ActorView, read_cases
from recast.metrics.perceptual import ImageDistance
from recast.metrics.table import rounded
from recast.reconstruction import SceneConfig
from recast.reporting.canvas import at_width
from recast.runs.actor import ActorMakers, StageProgress, make_actor, refine_actor
from recast.runs.layout import ACTOR_FOLDER
from recast.scene import StreetScene
from recast.studies.generation.maker import case_observation
from recast.studies.sheets import ComparedView, comparison_sheet

METRICS_FILE, TIMINGS_FILE = "metrics.json", "timings.json"
MODELS = ("reconstructed", "registered", "refined")
"""The scene's own model of the track, the actor as registered, and as refined."""
_TILE_WIDTH = 960
_SHOWN = 6


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
        input: name of the picture that it was made from.
        input_azimuth_deg: azimuth from which that picture was taken, degrees.
        further: names of other pictures that it was made from.
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
        mean: mean of every score over the vehicles, each counting the same.
        failures: reason why a vehicle could not be made, by its id.
    """

    generator: str
    seed: int
    vehicles: tuple[VehicleResult, ...]
    failures: dict[str, str]
    mean: dict[str, float]

    def to_json(self) -> dict[str, Any]:
        """Plain data, rounded to six decimals."""
        return rounded({"version": 1, **asdict(self)})


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
        folder: real crops or a vehicle set, see `read_cases`.
        seed: seed of the generator, and of the choice of input views.
        views: largest number of input views that a vehicle is made from.

    Raises:
        InputError: the set is at fault, no vehicle could be made, or `out` exists.
    """
    cases = read_cases(folder, seed, limit, views)
    results, failures, seconds = [], {}, {}
    with atomic_folder(out) as partial:
        for index, case in enumerate(cases):
            observations = [case_observation(case, view) for view in case.inputs]
            start = time.perf_counter()
            try:
                first = replace(observations[0], further=tuple(observations[1:views]))
                asset = generated(generator, first, seed)
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
                "check that the generator fits these images",
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


def _caption(view: ActorView, scores: dict[str, float]) -> str:
    decibels = f"PSNR {scores['psnr']:.1f} ({scores['psnr_vehicle']:.1f})"
    return (
        f"azimuth {view.azimuth_deg:.0f}\n"
        f"{decibels}  SSIM {scores['ssim']:.3f}  IoU {scores['mask_iou']:.2f}"
    )


@dataclass(frozen=True)
class TrackResult:
    """One track.

    Attributes:
        images: number of held-out images that show it.
        psnr, ssim: means by model.
    """

    track_id: str
    images: int
    psnr: dict[str, float]
    ssim: dict[str, float]
    provenance: dict[str, Any]


def evaluate_tracks(
    log: DrivingLog,
    scene: StreetScene,
    config: SceneConfig,
    tracks: Sequence[str],
    makers: ActorMakers,
    out: Path,
    seed: int = 0,
    progress: StageProgress | None = None,
) -> list[TrackResult]:
    """Make and refine the actor of every track, and compare it with held-out images.

    Writes `metrics.json`, and for every track a folder with its actor and `held_out.png` (each row
    an image: recording, reconstructed, registered, refined) to `out`, whole or not at all.

    Args:
        scene: scene that was reconstructed from the log, with models of the tracks.
        config: settings of the scene's training.
        progress: function that is told the stage, the pieces done, and all pieces of the stage.

    Raises:
        InputError: no track named, one that the scene has no model of or no held-out image shows;
            see `make_actor`.
    """
    if not tracks:
        raise InputError(
            "`track`", "tracks", "none is given", "give a track; `recast log info` lists them"
        )
    for track_id in tracks:
        require_model(scene, track_id)
    results = []
    with atomic_folder(out) as folder:
        for number, track_id in enumerate(tracks):
            place = folder / f"track_{number}"
            place.mkdir()
            make_actor(log, track_id, makers, seed, place, config, progress=progress)
            refined = refine_actor(place, scene, seed, place / "refined", progress)
            models = {
                "reconstructed": scene,
                "registered": insert(scene, load_actor(place / ACTOR_FOLDER)),
                "refined": insert(scene, refined),
            }
            views = list(held_out_track(log, track_id, config, models))
            if not views:
                raise InputError(
                    log.name,
                    f"track {track_id}",
                    "is not in any held-out image",
                    "choose another track",
                )
            PilImage.fromarray(_sheet(views)).save(place / "held_out.png", format="PNG")
            results.append(_result(track_id, views, refined))
        write_json(
            folder / "metrics.json",
            rounded({"version": 1, "seed": seed, "tracks": [vars(one) for one in results]}),
        )
    return results


def tracks_table(results: Sequence[TrackResult]) -> Table:
    """PSNR and SSIM of every track by model; 80 columns wide."""
    table = Table(
        title="held-out images, in the vehicle's box: PSNR dB, SSIM",
        title_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    for heading in ("track", "images", "made by", *MODELS):
        table.add_column(heading)
    for one in results:
        chosen = [c for c in one.provenance["candidates"] if c["chosen"]]
        made_by = chosen[0]["label"] if chosen else one.provenance["generator"]
        cells = [f"{one.psnr[model]:.2f} {one.ssim[model]:.3f}" for model in MODELS]
        table.add_row(one.track_id, str(one.images), made_by, *cells)
    return table


def _result(track_id: str, views: Sequence[TrackView], actor: Actor) -> TrackResult:
    return TrackResult(
        track_id=track_id,
        images=len(views),
        psnr={model: float(np.mean([v.psnr[model] for v in views])) for model in MODELS},
        ssim={model: float(np.mean([v.ssim[model] for v in views])) for model in MODELS},
        provenance=actor.provenance.model_dump(mode="json"),
    )


def _sheet(views: Sequence[TrackView]) -> NDArray[np.uint8]:
    """Pictures of a few images, one below the other, of one width."""
    some = np.unique(np.linspace(0, len(views) - 1, _SHOWN).round().astype(int))
    return np.concatenate([at_width(views[index].picture, _TILE_WIDTH) for index in some], axis=0)
