"""Judge vehicles by a log's own images that they were not made from: held-out ones, hidden sides.

What the scene reconstructed is compared with the actor as registered and as refined. If the images
of one side are hidden from all that makes street and vehicle, they show what was made up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage
from rich.box import SIMPLE_HEAD
from rich.table import Table

from recast.actors import Actor, insert, load_actor
from recast.actors.insert import require_model
from recast.actors.observe import TrackSides, gather_evidence, split_sides, without_sides
from recast.core.errors import InputError
from recast.core.files import atomic_folder, write_json
from recast.logs import DrivingLog
from recast.metrics.actor_scores import TrackView, held_out_track
from recast.metrics.perceptual import ImageDistance
from recast.metrics.table import rounded
from recast.reconstruction import train_scene
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.views import is_held_out
from recast.reporting.drawing import at_width
from recast.runs.actor import ActorMakers, StageProgress, make_actor, refine_actor
from recast.runs.run_folder import ACTOR_FOLDER
from recast.scene import StreetScene

METRICS_FILE = "metrics.json"
MODELS = ("reconstructed", "registered", "refined")
HIDDEN_MODELS = ("reconstructed", "replaced", "all images: reconstructed", "all images: replaced")
"""What is compared on the hidden side; the last two saw it, and say what can be reached."""
_TILE_WIDTH = 960
_SHOWN = 6


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
    _require_models(scene, tracks)
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
            PilImage.fromarray(_track_sheet(views)).save(place / "held_out.png", format="PNG")
            results.append(_of_track(track_id, views, refined))
        write_json(
            folder / METRICS_FILE,
            rounded({"version": 1, "seed": seed, "tracks": [vars(one) for one in results]}),
        )
    return results


@dataclass(frozen=True)
class HiddenResult:
    """A track whose images from one side were hidden.

    Attributes:
        degrees: angle between each hidden image and all that were looked at.
        kept, between, hidden: number of images, see `TrackSides`; of the hidden ones, those scored.
        scores: mean of each measure by model: psnr, ssim, mask_iou, and lpips with weights.
    """

    track_id: str
    degrees: float
    kept: int
    between: int
    hidden: int
    scores: dict[str, dict[str, float]]


def evaluate_hidden(
    log: DrivingLog,
    scene: StreetScene,
    config: SceneConfig,
    tracks: Sequence[str],
    degrees: float,
    makers: ActorMakers,
    out: Path,
    seed: int = 0,
    distance: ImageDistance | None = None,
    progress: StageProgress | None = None,
) -> list[HiddenResult]:
    """Hide the images of one side of each track, and compare what was made without them with them.

    Hidden are the images more than an angle from all that are kept (`split_sides`), from the
    street's training (the box, grown by a quarter, in each image that is not kept), from the choice
    of the view, registration and refinement alike. LiDAR points stay, and the models
    stand where `scene` has learned that the track stood. Writes `metrics.json`, and for every track
    a folder with its street, its actors and `hidden.png` (each row an image: recording, then
    `HIDDEN_MODELS`) to `out`, whole or not at all.

    Args:
        scene: street that was reconstructed from all images, with models of the tracks.
        config: settings of its training, with which one without the hidden images is trained.
        degrees: angle that is hidden.
        distance: LPIPS, if its weights are there.

    Raises:
        InputError: see `split_sides` and `evaluate_tracks`; no hidden image has a mask.
    """
    _require_models(scene, tracks)
    sides = {track_id: split_sides(log, track_id, config, degrees) for track_id in tracks}
    results = []
    with atomic_folder(out) as folder:
        for number, (track_id, side) in enumerate(sides.items()):
            place, unseen = folder / f"track_{number}", (*side.between, *side.hidden)
            forced = config.model_copy(update={"force_dynamic": (*config.force_dynamic, track_id)})
            blind = train_scene(
                without_sides(log, track_id, unseen), place / "street", forced
            ).scene

            made = partial(_made, log, track_id, config, makers, seed, place, progress)
            half = made("one_side", blind, {one.key for one in unseen})
            # Where it stood at the hidden times, no image could correct: looks are asked for here.
            posed = replace(blind.actors[track_id], trajectory=scene.actors[track_id].trajectory)
            blind = replace(blind, actors={**blind.actors, track_id: posed})
            models = {
                "reconstructed": blind,
                "replaced": insert(blind, replace(half, trajectory=None)),
                "all images: reconstructed": scene,
                "all images: replaced": insert(scene, made("all_images", scene, set())),
            }
            views = _hidden_views(log, track_id, config, side, models, makers, distance)
            PilImage.fromarray(_track_sheet(views)).save(place / "hidden.png", format="PNG")
            results.append(_of_hidden(track_id, degrees, side, views))
        found = [vars(one) for one in results]
        write_json(folder / METRICS_FILE, rounded({"version": 1, "seed": seed, "hidden": found}))
    return results


def _require_models(scene: StreetScene, tracks: Sequence[str]) -> None:
    if not tracks:
        raise InputError(
            "`track`", "tracks", "none is given", "give a track; `recast log info` lists them"
        )
    for track_id in tracks:
        require_model(scene, track_id)


def _made(
    log: DrivingLog,
    track_id: str,
    config: SceneConfig,
    makers: ActorMakers,
    seed: int,
    folder: Path,
    progress: StageProgress | None,
    name: str,
    street: StreetScene,
    left_out: AbstractSet[tuple[str, int]],
) -> Actor:
    """An actor made and refined without some images, in a folder of a name."""

    def usable(camera: str, frame: int) -> bool:
        return (camera, frame) not in left_out and not is_held_out(frame, config)

    place = folder / name
    make_actor(log, track_id, makers, seed, place, config, progress=progress, usable=usable)
    return refine_actor(place, street, seed, place / "refined", progress)


def _hidden_views(
    log: DrivingLog,
    track_id: str,
    config: SceneConfig,
    side: TrackSides,
    models: Mapping[str, StreetScene],
    makers: ActorMakers,
    distance: ImageDistance | None,
) -> list[TrackView]:
    hidden = {one.key for one in side.hidden}
    seen = gather_evidence(
        log,
        track_id,
        segmenter=makers.segmenter,
        config=config,
        usable=lambda camera, frame: (camera, frame) in hidden,
    )
    masks = {(one.camera_name, one.frame): one for one in seen.sightings}
    views = list(held_out_track(log, track_id, config, models, masks=masks, distance=distance))
    if not views:
        problem = "has no mask in any hidden image"
        raise InputError(log.name, f"track {track_id}", problem, "choose another track")
    return views


def hidden_table(results: Sequence[HiddenResult]) -> Table:
    """Scores of the hidden images by model; 80 columns wide."""
    keys = list(results[0].scores[HIDDEN_MODELS[0]])
    names = {"psnr": "PSNR dB", "ssim": "SSIM", "mask_iou": "mask IoU", "lpips": "LPIPS"}
    title = f"images {results[0].degrees:g} degrees from all that were looked at"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("track")
    table.add_column("images")
    for key in keys:
        table.add_column(names[key], justify="right")
    for one in results:
        table.add_row(f"track {one.track_id}", f"{one.kept} kept, {one.hidden} hidden")
        for model, scores in one.scores.items():
            digits = [f"{scores[key]:.{2 if key == 'psnr' else 3}f}" for key in keys]
            table.add_row(f"  {model}", "", *digits, end_section=model == HIDDEN_MODELS[-1])
    return table


def _of_hidden(
    track_id: str, degrees: float, side: TrackSides, views: Sequence[TrackView]
) -> HiddenResult:
    keys = ("psnr", "ssim", "mask_iou") + (("lpips",) if views[0].lpips else ())
    scores = {
        model: {key: float(np.mean([getattr(v, key)[model] for v in views])) for key in keys}
        for model in HIDDEN_MODELS
    }
    return HiddenResult(track_id, degrees, len(side.kept), len(side.between), len(views), scores)


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


def _of_track(track_id: str, views: Sequence[TrackView], actor: Actor) -> TrackResult:
    return TrackResult(
        track_id=track_id,
        images=len(views),
        psnr={model: float(np.mean([v.psnr[model] for v in views])) for model in MODELS},
        ssim={model: float(np.mean([v.ssim[model] for v in views])) for model in MODELS},
        provenance=actor.provenance.model_dump(mode="json"),
    )


def _track_sheet(views: Sequence[TrackView]) -> NDArray[np.uint8]:
    """Pictures of a few images, one below the other, of one width."""
    some = np.unique(np.linspace(0, len(views) - 1, _SHOWN).round().astype(int))
    return np.concatenate([at_width(views[index].picture, _TILE_WIDTH) for index in some], axis=0)
