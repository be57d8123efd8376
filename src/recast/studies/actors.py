"""Judge actors by a log's held-out images: reconstructed, registered and refined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage
from rich.box import SIMPLE_HEAD
from rich.table import Table

from recast.actors import Actor, insert, load_actor
from recast.actors.insert import require_model
from recast.core.errors import InputError
from recast.core.files import atomic_folder, write_json
from recast.logs import DrivingLog
from recast.metrics.actor_scores import TrackView, held_out_track
from recast.metrics.table import rounded
from recast.reconstruction.config import SceneConfig
from recast.reporting.drawing import at_width
from recast.runs.actor import ActorMakers, StageProgress, make_actor, refine_actor
from recast.runs.run_folder import ACTOR_FOLDER
from recast.scene import StreetScene

MODELS = ("reconstructed", "registered", "refined")
"""The scene's own model of the track, the actor as registered, and as refined."""
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
