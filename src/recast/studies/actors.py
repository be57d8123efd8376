"""Judge actors: by reserved images of the vehicles of a set, or by held-out images of a log.

Sheets show one vehicle's views with their differences, or the vehicles of a study.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage
from rich.box import SIMPLE_HEAD
from rich.table import Table

from recast.actors import Actor, ActorGenerator, insert, load_actor
from recast.actors.generate import generated
from recast.actors.insert import require_model
from recast.actors.place import PlacementReport, place_asset
from recast.arrays import Array, Image
from recast.core.diagnostics import Progress
from recast.core.errors import InputError
from recast.core.files import atomic_folder, write_json
from recast.core.images import draw_text
from recast.logs import DrivingLog
from recast.metrics.actor_scores import (
    ACTOR_COLUMNS,
    ActorView,
    Mask,
    ScoredCutout,
    TrackView,
    Window,
    case_observation,
    drawn,
    held_out_track,
    mean_scores,
    photographed,
    read_cases,
    score_view,
)
from recast.metrics.perceptual import ImageDistance
from recast.metrics.table import rounded
from recast.reconstruction.config import SceneConfig
from recast.reporting.drawing import at_width
from recast.runs.actor import ActorMakers, StageProgress, make_actor, refine_actor
from recast.runs.run_folder import ACTOR_FOLDER
from recast.scene import StreetScene

_WIDTH, _HEIGHT = 320, 230  # pixels of a tile
_EDGE, _TWO_LINES = 4, 40
_GREY = 0.55  # behind the vehicles, so that black ones are seen too
TILE = (136, 92)
"""Width and height of a tile, pixels."""
_GAP, _HEADER, _CAPTION = 12, 26, 14
_MARGIN = 0.1


@dataclass(frozen=True)
class ComparedView:
    """A reserved view.

    Attributes:
        caption: text that says where the view is from, and the scores.
        truth, shown: photograph and render.
    """

    caption: str
    truth: ScoredCutout
    shown: ScoredCutout


def comparison_sheet(title: str, source: ScoredCutout, views: Sequence[ComparedView]) -> Image:
    """(H, W, 3) uint8; a row for every view, the input in front of the first.

    Tiles show what surrounds both vehicles, before grey; the difference is the absolute one of
    the images before black, as they are scored.
    """
    first = _fitted(source.before(_GREY)[_around(source.mask)], _GREY)
    rows = []
    for index, view in enumerate(views):
        window = _around(view.truth.mask | view.shown.mask)
        tiles = [
            first if index == 0 else np.full_like(first, 255),
            _fitted(view.truth.before(_GREY)[window], _GREY),
            _fitted(view.shown.before(_GREY)[window], _GREY),
            _fitted(np.abs(view.shown.rgb - view.truth.rgb)[window], 0.0),
        ]
        captions = [
            f"input: {title}" if index == 0 else "",
            "photograph",
            f"render  {view.caption}",
            "difference",
        ]
        rows.append(np.hstack([_captioned(t, c) for t, c in zip(tiles, captions, strict=True)]))
    return np.vstack(rows)


def _around(mask: Mask) -> tuple[slice, slice]:
    """Rows and columns of the rectangle around a mask (H, W) and a margin of 4 % of its width."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    margin = 1 + int(0.04 * (columns[-1] - columns[0]))
    return (
        slice(max(int(rows[0]) - margin, 0), int(rows[-1]) + 1 + margin),
        slice(max(int(columns[0]) - margin, 0), int(columns[-1]) + 1 + margin),
    )


def _fitted(image: Array, grey: float) -> Image:
    """An image (H, W, 3) in [0, 1] fitted into the middle of a tile of that grey."""
    height, width = image.shape[:2]
    scale = min(_WIDTH / width, _HEIGHT / height)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    fitted = cv2.resize((image * 255).round().astype(np.uint8), size, interpolation=way)
    middle = np.full((_HEIGHT, _WIDTH, 3), round(grey * 255), np.uint8)
    left, top = (_WIDTH - size[0]) // 2, (_HEIGHT - size[1]) // 2
    middle[top : top + size[1], left : left + size[0]] = fitted
    return middle


def _captioned(picture: Image, caption: str) -> Image:
    """The picture under its caption of up to two lines, with a white edge."""
    page = np.full((_HEIGHT + _TWO_LINES + _EDGE, _WIDTH + _EDGE, 3), 255, np.uint8)
    page[_TWO_LINES : _TWO_LINES + _HEIGHT, :_WIDTH] = picture
    for line, text in enumerate(caption.split("\n")):
        draw_text(page, (4, 15 + 18 * line), text, _INK, 14, "ls")
    return page


@dataclass(frozen=True)
class SheetRow:
    """One vehicle.

    Attributes:
        caption: text under the input.
        source: the input's tile.
        strips: the views of each model, in their order; None where it could not be made.
        truth: the photographs of the views.
    """

    caption: str
    source: Image
    strips: Sequence[Image | None]
    truth: Image


def tile_window(mask: Mask) -> Window:
    """The rectangle of a tile's shape around a mask (H, W) and a margin."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return Window(0, 0, *mask.shape)
    width = (1 + 2 * _MARGIN) * (columns[-1] + 1 - columns[0])
    height = (1 + 2 * _MARGIN) * (rows[-1] + 1 - rows[0])
    width, height = max(width, height * TILE[0] / TILE[1]), max(height, width * TILE[1] / TILE[0])
    left = (columns[0] + columns[-1] + 1 - width) / 2
    top = (rows[0] + rows[-1] + 1 - height) / 2
    return Window(round(top), round(left), max(1, round(height)), max(1, round(width)))


def tile(cutout: ScoredCutout, window: Window) -> Image:
    """A vehicle before grey, a window of it brought to the size of a tile."""
    pixels = (cutout.within(window).before(_GREY) * 255).round().astype(np.uint8)
    way = cv2.INTER_AREA if window.width > TILE[0] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(pixels, TILE, interpolation=way), np.uint8)


def strip(cutouts: Sequence[ScoredCutout], windows: Sequence[Window]) -> Image:
    """Tiles of several views side by side, a thin white line after each."""
    tiles = []
    for cutout, window in zip(cutouts, windows, strict=True):
        one = tile(cutout, window)
        one[:, -1:] = 255
        tiles.append(one)
    return np.hstack(tiles)


def sheet(title: str, models: Sequence[str], rows: Sequence[SheetRow]) -> Image:
    """(H, W, 3) uint8.

    Args:
        models: names of the columns between input and truth.
    """
    views = max(row.truth.shape[1] for row in rows)
    width = TILE[0] + (len(models) + 1) * (views + _GAP)
    lines = [_header([title, *models, "truth"], views, width)]
    for row in rows:
        line = np.full((TILE[1] + _CAPTION, width, 3), 255, np.uint8)
        line[: TILE[1], : TILE[0]] = row.source
        draw_text(line, (2, TILE[1] + 11), row.caption, _INK, 10, "ls")
        left = TILE[0] + _GAP
        for shown in [*row.strips, row.truth]:
            if shown is None:
                draw_text(line, (left + 8, TILE[1] // 2), "not made", _INK, 14, "ls")
            else:
                line[: TILE[1], left : left + shown.shape[1]] = shown
            left += views + _GAP
        lines.append(line)
    return np.vstack(lines)


def pages(rows: Sequence[SheetRow], most: int = 10) -> list[Sequence[SheetRow]]:
    """Rows by sheet, evenly."""
    count = -(-len(rows) // most)
    each = -(-len(rows) // count) if count else 1
    return [rows[first : first + each] for first in range(0, len(rows), each)]


def applied_caption(id: str, applied: Sequence[Mapping[str, float | str]]) -> str:
    """What stands under an input: the vehicle, and what its picture went through."""
    kinds = ", ".join(f"{one['name']} {float(one['severity']):.1f}" for one in applied)
    return f"{id}: {kinds}" if kinds else id


def _header(names: Sequence[str], views: int, width: int) -> Image:
    line = np.full((_HEADER, width, 3), 255, np.uint8)
    left = 0
    for index, name in enumerate(names):
        draw_text(line, (left + 2, 17), name, _INK, 14, "ls")
        left += TILE[0] + _GAP if index == 0 else views + _GAP
    return line


_INK = (40, 40, 40)
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
            PilImage.fromarray(sheet).save(partial / f"{case.id}.png", format="PNG")
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
