"""Several vehicles for one track: the generator `auto` offers them, the evidence chooses.

A generator that draws another seed draws another car: an estate, a pickup, a blur. Each candidate
is registered and judged by what the log knows: masks of many images, LiDAR hits and free space,
colours. A wrong class shows in all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from recast.actors.actor import Actor, CandidateRecord, CandidateScore
from recast.actors.drawing import colour_difference
from recast.actors.evidence import Evidence, Sighting
from recast.actors.generate import (
    ActorGenerator,
    Asset,
    BaseGenerator,
    candidates_of,
    recast_mini_generator,
)
from recast.actors.icp import fit_of, outer_surface, thinned
from recast.actors.observation import Observation
from recast.actors.register import register
from recast.actors.template import TemplateGenerator
from recast.core.errors import InputError
from recast.core.progress import Progress
from recast.logs import DrivingLog
from recast.scene.actor import draw

_IMAGES = 16
_LIDAR_POINTS = 6000
_LEAST_LIDAR = 50  # points that say something of a shape
# Differences that count as one unit: overlap, share of LiDAR points met, of the surface in free
# space, and of colours in display values.
_OUTLINE, _LIDAR, _FREE, _COLOUR = 0.03, 0.06, 0.03, 0.03
LEAST_OUTLINE, LEAST_LIDAR = 0.75, 0.7
"""Overlap with the masks, and share of the LiDAR points within 10 cm, of a vehicle that fits."""


class AutoGenerator(BaseGenerator):
    """Offers the vehicles of generators; of the template and the small model if none are given."""

    name = "auto"

    def __init__(self, generators: Sequence[ActorGenerator] | None = None) -> None:
        self.generators = generators or (TemplateGenerator(), recast_mini_generator())

    def candidates(self, observation: Observation, seed: int) -> Sequence[Callable[[], Asset]]:
        """Those of each generator, in order."""
        return [
            make
            for generator in self.generators
            for make in candidates_of(generator, observation, seed)
        ]

    def generate(self, observation: Observation, seed: int) -> Asset:
        """The first one's vehicle, where there is no evidence to choose by."""
        return self.generators[0].generate(observation, seed)


@dataclass(frozen=True)
class CandidateChoice:
    """The best candidate, registered, with the table of all in its provenance.

    It `fits` if it has the vehicle's shape; if not, it is the best of those that have not.
    """

    actor: Actor
    fits: bool


def choose(
    makers: Sequence[Callable[[], Asset]],
    observation: Observation,
    log: DrivingLog,
    evidence: Evidence,
    progress: Progress | None = None,
) -> CandidateChoice:
    """Register and score every candidate, and take the best.

    Args:
        makers: what makes each candidate from the observation.
        evidence: evidence of the track.
        progress: called with the number of candidates done, and of all.

    Raises:
        InputError: none could be made and registered; the last one's reason.
    """
    track = log.tracks[observation.track_id]
    rows: list[CandidateRecord] = []
    best: tuple[float, int, Actor] | None = None
    failure: InputError | None = None
    for index, make in enumerate(makers):
        if progress is not None:
            progress(index, len(makers))
        try:
            asset = make()
            actor = register(asset, observation, log, track)
        except InputError as error:
            failure = error
            rows.append(CandidateRecord(generator="", seed=0, label=f"none: {error}"))
            continue
        score = candidate_score(actor, evidence)
        rows.append(
            CandidateRecord(
                generator=asset.generator, seed=asset.seed, label=_label(asset), score=score
            )
        )
        if best is None or score.total > best[0]:
            best = (score.total, index, actor)
    if progress is not None:
        progress(len(makers), len(makers))
    if best is None:
        raise failure or InputError(
            "candidates", "vehicles", "none was generated", "give at least one generator"
        )
    _, chosen, actor = best
    rows[chosen] = rows[chosen].model_copy(update={"chosen": True})
    provenance = actor.provenance.model_copy(update={"candidates": tuple(rows)})
    kept = rows[chosen].score
    assert kept is not None
    return CandidateChoice(replace(actor, provenance=provenance), kept.fits)


def _label(asset: Asset) -> str:
    style = asset.details.get("style") or asset.details.get("file")
    return f"seed {asset.seed}" if style is None else str(style)


def candidate_score(actor: Actor, evidence: Evidence) -> CandidateScore:
    """How well a registered vehicle explains what the log knows."""
    views = _chosen(evidence.sightings)
    overlap, colour = _pictures(actor, views)
    surface = outer_surface(actor.gaussians)
    lidar, median = 1.0, 0.0
    measured = len(evidence.hits) >= _LEAST_LIDAR
    if measured:
        hits = thinned(evidence.hits, _LIDAR_POINTS)
        fit = fit_of(surface.points, np.asarray(hits, np.float64))
        lidar, median = fit.inlier_share, fit.median
    free = float(evidence.free.holds(surface.points).mean())
    total = -free / _FREE
    if views:
        total += overlap / _OUTLINE - colour / _COLOUR
    if measured:
        total += lidar / _LIDAR
    return CandidateScore(
        outline=overlap if views else None,
        colour=colour if views else None,
        lidar=lidar if measured else None,
        lidar_median=median if measured else None,
        free=free,
        total=total,
        fits=(not views or overlap >= LEAST_OUTLINE) and (not measured or lidar >= LEAST_LIDAR),
    )


def _chosen(sightings: tuple[Sighting, ...]) -> list[Sighting]:
    """The best images of equal stretches of time."""
    count = min(_IMAGES, len(sightings))
    parts = np.array_split(np.arange(len(sightings)), count) if count else []
    return [sightings[max(part, key=lambda i: sightings[i].weight)] for part in parts]


def _pictures(actor: Actor, views: list[Sighting]) -> tuple[float, float]:
    """Weighted mean overlap of outlines, and difference of colours after one gain for all."""
    if not views:
        return 0.0, 1.0
    overlaps, weights, shown, wanted = [], [], [], []
    for view in views:
        with torch.no_grad():
            picture = draw(actor.gaussians, view.camera_from_object, view.camera, actor.low_pass)
        rgb, covered = picture.rgb.numpy().astype(np.float64), picture.alpha.numpy() > 0.5
        mask, known = view.mask > 0.5, view.trust > 0
        union = float(((covered | mask) & known).sum())
        both = covered & mask & known
        overlaps.append(float(both.sum()) / union if union else 0.0)
        weights.append(view.weight)
        shown.append(rgb[both])
        wanted.append(view.image[both] / 255.0)
    overlap = float(np.average(overlaps, weights=weights))
    drawn, target = np.concatenate(shown), np.concatenate(wanted)
    return overlap, colour_difference(drawn, target) if len(drawn) else 1.0
