"""Registration: a generated vehicle to the logged box and its LiDAR points.

Axes, isotropic scale from the length, yaw over the whole circle with front and back decided by
evidence, then constrained ICP; the wheels stand on the box's ground plane throughout.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recast.actors.actor import (
    Actor,
    CandidateRecord,
    CandidateScore,
    FrontEvidence,
    Provenance,
    RegistrationReport,
    triple,
)
from recast.actors.evidence import Evidence, Sighting
from recast.actors.generate import (
    ActorGenerator,
    Asset,
    BaseGenerator,
    candidates_of,
)
from recast.actors.icp import (
    FitSurface,
    IcpLimits,
    align,
    bounds,
    extent,
    fit_of,
    outer_surface,
    thinned,
)
from recast.actors.insert import (
    colour_difference,
    compare_views,
    contact_shadow,
    shadow_below,
)
from recast.actors.observation import SIDES, Observation
from recast.actors.observe import require_points
from recast.actors.parametric import ParametricGenerator
from recast.actors.people import PeopleGenerator
from recast.actors.place import (
    COARSE_YAWS,
    FINE_YAWS,
    PoseAgreement,
    Start,
    front_votes,
    heading_agreement,
    stand_on_box,
    stood_up,
)
from recast.actors.template import TemplateGenerator
from recast.arrays import Array
from recast.cameras import PinholeCamera
from recast.core.diagnostics import Progress
from recast.core.errors import InputError
from recast.geometry import se3
from recast.geometry.colour import cielab, gamma_to_linear
from recast.logs import DrivingLog, Track, Trajectory, track_points
from recast.logs.types import PEOPLE
from recast.scene.actor import draw, look_at
from recast.splats import Gaussians, LowPass
from recast.splats.gaussians import C0

_LIDAR_POINTS = 6000
_SURFACE_POINTS = 4000  # used in the yaw search
_BLACK = 0.02  # display value: less is noise where brightness is compared
_WAY_STEP = 0.3  # metres between places of a person's way: labels of who stands are noisy
_SIDE_BAND = 0.25  # metres inside a face of the box within which points count for that side


def register(asset: Asset, observation: Observation, log: DrivingLog, track: Track) -> Actor:
    """Place an asset in the actor frame of a track.

    Args:
        observation: observation that the asset was made from.
        track: the vehicle it stands for.

    Raises:
        InputError: fewer than 20 LiDAR points on the track, or see `stood_up`.
    """
    same = observation.track_id == track.track_id  # reading all sweeps again takes seconds
    points = observation.points if same else track_points(log, track).points
    require_points(points, log, track.track_id)
    lidar = thinned(np.asarray(points, np.float64), _LIDAR_POINTS)
    size = np.asarray(track.size, np.float64)
    if asset.gait is not None:
        _require_gait(asset, track)
        return _as_person(asset, observation, track, lidar, len(points))
    gaussians, surface = stood_up(asset)
    start, front = _orientation(gaussians, surface, lidar, size, observation, track, asset)
    placed = start.apply(surface)
    before = fit_of(placed.points, lidar)
    free = align(placed, lidar)
    result = align(placed, lidar, floor=-size[2] / 2)
    after = fit_of(result.apply(placed.points), lidar)

    scale = start.scale * result.scale
    matrix = result.matrix @ se3.from_rotation_translation(
        start.matrix[:3, :3], start.matrix[:3, 3] * result.scale
    )
    registered = gaussians.transformed(torch.from_numpy(matrix), scale)
    sides = extent(placed.points)
    low, high = bounds(result.apply(placed.points))
    report = RegistrationReport(
        axes=asset.axes.name,
        initial_scale=start.scale,
        initial_yaw=start.yaw,
        width_over_box=float(sides[1] / size[1]),
        height_over_box=float(sides[2] / size[2]),
        front=front,
        before=before,
        after=after,
        icp_scale=result.scale,
        icp_yaw=result.yaw,
        icp_translation=triple(result.translation),
        icp_iterations=result.iterations,
        icp_converged=result.converged,
        ground_gap=float(free.apply(placed.points)[:, 2].min() + size[2] / 2),
        lidar_points=len(points),
        lidar_by_side=lidar_by_side(np.asarray(points, np.float64), size),
        floaters=len(asset.gaussians) - len(gaussians),
        left_over_right=_left_over_right(gaussians, result.apply(placed.points), surface.index),
    )
    return Actor(
        track_id=track.track_id,
        category=track.category,
        size=size,
        gaussians=registered,
        shadow=contact_shadow(low, high, floor=-size[2] / 2),
        provenance=Provenance.of(asset, observation, report),
        source=observation.rgba,
        low_pass=asset.low_pass,
    )


def _require_gait(asset: Asset, track: Track) -> None:
    """Refuse a gait of a vehicle, and one that a generator of users' own made wrong."""
    assert asset.gait is not None
    where = f"generator {asset.generator}"
    if track.category not in PEOPLE:
        problem = f"is a person, and track {track.track_id} is of the category {track.category}"
        raise InputError(where, "gait", problem, "choose another `generator`")
    try:
        asset.gait.validate("gait", len(asset.gaussians))
    except ValueError as error:
        raise InputError(where, "gait", str(error), "mend the generator") from None


def _way(trajectory: Trajectory) -> Array:
    """(K, 2) places of a track without the noise of its labels, and one a little ahead."""
    places = trajectory.poses[:, :2, 3]
    kept = [places[0]]
    for place in places[1:]:
        if np.hypot(*(place - kept[-1])) > _WAY_STEP:
            kept.append(place)
    ahead = trajectory.poses[-1, :2, 0] if len(kept) == 1 else kept[-1] - kept[-2]
    return np.stack([*kept, kept[-1] + 0.1 * ahead / np.linalg.norm(ahead)])


def _as_person(
    asset: Asset, observation: Observation, track: Track, lidar: Array, points: int
) -> Actor:
    """A person on the track's way, in the box where its generator put it.

    ICP would turn and shift a body whose limbs were elsewhere at each sweep.
    """
    assert asset.gait is not None
    size, trajectory = np.asarray(track.size, np.float64), track.trajectory
    surface = outer_surface(asset.gaussians)
    low, high = bounds(surface.points)
    time = observation.view.timestamp_us
    gait = replace(asset.gait, way=_way(trajectory))
    if trajectory.covers(time):
        gone = gait.gone_at(trajectory.at(time))
        gait = replace(gait, phase=float(gait.phase - gone / gait.cycle))
    fit = fit_of(surface.points, lidar)
    sides = high - low
    report = RegistrationReport(
        axes=asset.axes.name,
        initial_scale=1.0,
        initial_yaw=0.0,
        width_over_box=float(sides[1] / size[1]),
        height_over_box=float(sides[2] / size[2]),
        front=FrontEvidence(
            votes={"declared": 1.0},
            flipped=False,
            heading_agreement=heading_agreement(track),
            margin=1.0,
        ),
        before=fit,
        after=fit,
        icp_scale=1.0,
        icp_yaw=0.0,
        icp_translation=(0.0, 0.0, 0.0),
        icp_iterations=0,
        icp_converged=True,
        ground_gap=float(low[2] + size[2] / 2),
        lidar_points=points,
        lidar_by_side=lidar_by_side(lidar, size),
    )
    return Actor(
        track_id=track.track_id,
        category=track.category,
        size=size,
        gaussians=asset.gaussians,
        shadow=shadow_below(asset.gaussians, size),
        provenance=Provenance.of(asset, observation, report),
        source=observation.rgba,
        low_pass=asset.low_pass,
        gait=gait,
    )


def _left_over_right(gaussians: Gaussians, points: Array, index: NDArray[np.int64]) -> float:
    """Linear brightness of the left third of a placed surface (N, 3) over that of the right one."""
    display = (0.5 + C0 * gaussians.sh[index, 0]).clamp(_BLACK, 1).mean(dim=1)
    look = gamma_to_linear(display.numpy())
    low, high = bounds(points)
    across = (points[:, 1] - low[1]) / (high[1] - low[1])
    left, right = look[across > 2 / 3], look[across < 1 / 3]
    return float(left.mean() / right.mean()) if len(left) and len(right) else 1.0


def lidar_by_side(points: Array, size: Array) -> dict[str, int]:
    """LiDAR points (N, 3) within 0.25 m of each face of the box, or beyond it."""
    half = size / 2
    return {
        name: int(np.sum(sign * points[:, axis] > half[axis] - _SIDE_BAND))
        for name, (axis, sign) in SIDES.items()
    }


def _orientation(
    gaussians: Gaussians,
    surface: FitSurface,
    lidar: Array,
    size: Array,
    observation: Observation,
    track: Track,
    asset: Asset,
) -> tuple[Start, FrontEvidence]:
    """Search the yaw over the circle, then decide between the best one and its opposite."""
    sparse = thinned(surface.points, _SURFACE_POINTS)
    few = thinned(lidar, 1500)

    def cost(yaw: float) -> float:
        return _search_cost(sparse, few, stand_on_box(sparse, yaw, size), size)

    best = min(min(COARSE_YAWS, key=cost) + FINE_YAWS, key=cost)
    if np.cos(best) < 0:
        best -= np.pi
    best = float((best + np.pi) % (2 * np.pi) - np.pi)

    starts = [
        stand_on_box(surface.points, best, size),
        stand_on_box(surface.points, best + np.pi, size),
    ]
    agreements = [
        _agreement(gaussians, asset.low_pass, surface, lidar, start, observation)
        for start in starts
    ]
    declared = asset.axes.declares_front
    heading = heading_agreement(track)
    votes = front_votes(agreements[0], agreements[1], declared, heading)
    total = sum(votes.values())
    chosen = 0 if total >= 0 else 1
    return starts[chosen], FrontEvidence(
        votes=votes, flipped=chosen == 1, heading_agreement=heading, margin=abs(total)
    )


def _search_cost(points: Array, lidar: Array, start: Start, size: Array) -> float:
    """Trimmed mean distance plus what width and height miss of the box, metres."""
    placed = se3.apply(start.matrix, points * start.scale)
    distance, _ = cKDTree(placed).query(lidar)
    kept = np.sort(distance)[: int(0.85 * len(distance)) or 1]
    misfit = np.abs(np.log(extent(placed)[1:] / size[1:])) * size[1:]
    return float(kept.mean() + 0.1 * misfit.sum())


def _agreement(
    gaussians: Gaussians,
    low_pass: LowPass,
    surface: FitSurface,
    lidar: Array,
    start: Start,
    observation: Observation,
) -> PoseAgreement:
    """What speaks for one orientation after a short alignment."""
    start = aligned(surface, lidar, start, observation.size)
    moved = gaussians.transformed(torch.from_numpy(start.matrix), start.scale)
    silhouette, colour = compare_views(moved, low_pass, observation)
    return PoseAgreement(fit_of(start.apply(surface).points, lidar), silhouette, colour)


def aligned(surface: FitSurface, lidar: Array, start: Start, size: Array) -> Start:
    """A start after a short alignment to LiDAR points (N, 3) in a box of `size` (3,)."""
    placed, few = start.apply(surface), thinned(lidar, 1500)
    result = align(placed, few, IcpLimits(iterations=15), floor=-size[2] / 2)
    matrix = result.matrix @ se3.from_rotation_translation(
        start.matrix[:3, :3], start.matrix[:3, 3] * result.scale
    )
    return Start(start.yaw, start.scale * result.scale, matrix)


# Several vehicles for one track: the generator `auto` offers them, the evidence chooses.
#
# A generator that draws another seed draws another car: an estate, a pickup, a blur. Each candidate
# is registered and judged by what the log knows: masks of many images, LiDAR hits and free space,
# colours. A wrong class shows in all of them.

_IMAGES = 16
_LEAST_LIDAR = 50  # points that say something of a shape
# Differences that count as one unit: overlap, share of LiDAR points met, of the surface in free
# space, and of colours in display values.
_OUTLINE, _LIDAR, _FREE, _COLOUR = 0.03, 0.06, 0.03, 0.03
# The same for the sides that nobody saw: log of the detail, and CIE Lab beyond what light does.
_FOG, _PAINT, _SAME_PAINT, _MOST_UNSEEN = 0.4, 5.0, 10.0, 3.0
_LOOK_PX = 128
_SEEN_WITHIN, _UNSEEN_BEYOND = 35.0, 60.0  # degrees from a view
LEAST_OUTLINE, LEAST_LIDAR = 0.75, 0.7
"""Overlap with the masks, and share of the LiDAR points within 10 cm, of a vehicle that fits."""
LEAST_OF_PEOPLE = 0.5, 0.6
"""The same of a person, whose limbs are thin in images and were elsewhere in each sweep."""


class AutoGenerator(BaseGenerator):
    """Offers the vehicles of generators: those given, or `template` and `parametric`, and for
    pedestrians and cyclists `people`."""

    name = "auto"

    def __init__(self, generators: Sequence[ActorGenerator] | None = None) -> None:
        self.generators = generators or (TemplateGenerator(), ParametricGenerator())
        self._of_people = generators or (PeopleGenerator(),)

    def candidates(self, observation: Observation, seed: int) -> Sequence[Callable[[], Asset]]:
        """Those of each generator, in order."""
        return [
            make
            for generator in self._makers(observation)
            for make in candidates_of(generator, observation, seed)
        ]

    def generate(self, observation: Observation, seed: int) -> Asset:
        """The first one's vehicle, where there is no evidence to choose by."""
        return self._makers(observation)[0].generate(observation, seed)

    def _makers(self, observation: Observation) -> Sequence[ActorGenerator]:
        return self._of_people if observation.category in PEOPLE else self.generators


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
    """Register and score every candidate, and take the best; finish it if it is a sketch.

    Args:
        makers: what makes each candidate from the observation.
        evidence: evidence of the track.
        progress: called with the number of candidates done, and of all.

    Raises:
        InputError: none could be made and registered; the last one's reason.
    """
    track = log.tracks[observation.track_id]
    rows: list[CandidateRecord] = []
    actors: dict[int, Actor] = {}  # by row
    finishes: dict[int, Callable[[], Asset] | None] = {}
    scores: dict[int, CandidateScore] = {}
    failure: InputError | None = None
    # While one is judged, the next is made; never two at once, since a generator may be anyone's.
    with ThreadPoolExecutor(max_workers=1) as making:
        coming = [making.submit(make) for make in makers]
        try:
            for index, one in enumerate(coming):
                if progress is not None:
                    progress(index, len(makers))
                try:
                    asset = one.result()
                    actor = register(asset, observation, log, track)
                except InputError as error:
                    failure = error
                    rows.append(CandidateRecord(generator="", seed=0, label=f"none: {error}"))
                    continue
                actors[len(rows)], scores[len(rows)] = actor, candidate_score(actor, evidence)
                finishes[len(rows)] = asset.finish
                rows.append(
                    CandidateRecord(generator=asset.generator, seed=asset.seed, label=_label(asset))
                )
        finally:
            making.shutdown(cancel_futures=True)
    if progress is not None:
        progress(len(makers), len(makers))
    if not scores:
        raise failure or InputError(
            "candidates", "vehicles", "none was generated", "give at least one generator"
        )
    scores = _judged_unseen(scores)
    chosen = max(scores, key=lambda row: scores[row].total)
    for row, score in scores.items():
        update = {"score": score, "chosen": row == chosen}
        rows[row] = rows[row].model_copy(update=update)
    actor, finish = actors[chosen], finishes[chosen]
    if finish is not None:
        actor = register(finish(), observation, log, track)
    provenance = actor.provenance.model_copy(update={"candidates": tuple(rows)})
    return CandidateChoice(replace(actor, provenance=provenance), scores[chosen].fits)


def _judged_unseen(scores: dict[int, CandidateScore]) -> dict[int, CandidateScore]:
    """The scores with what nobody saw in their totals: fog and another paint count against them.

    Detail is compared with that of the most detailed candidate, since none is the truth.
    """
    most = max(score.detail for score in scores.values())
    if most == 0:
        return scores
    judged = {}
    for row, score in scores.items():
        fog = float(np.log(most / max(score.detail, 1e-6))) / _FOG
        other = max(score.apart - _SAME_PAINT, 0.0) / _PAINT
        less = min(fog, _MOST_UNSEEN) + min(other, _MOST_UNSEEN)
        judged[row] = score.model_copy(update={"total": score.total - less})
    return judged


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
    detail, apart = unseen_look(actor, views)
    outline, met = LEAST_OF_PEOPLE if actor.gait is not None else (LEAST_OUTLINE, LEAST_LIDAR)
    return CandidateScore(
        detail=detail,
        apart=apart,
        outline=overlap if views else None,
        colour=colour if views else None,
        lidar=lidar if measured else None,
        lidar_median=median if measured else None,
        free=free,
        total=total,
        fits=(not views or overlap >= outline) and (not measured or lidar >= met),
    )


def unseen_look(actor: Actor, views: Sequence[Sighting]) -> tuple[float, float]:
    """Detail of the sides that no view shows, and how far their colours are from the seen ones'.

    Both sides of a vehicle are alike, so a side counts as seen if its mirror image was.

    Returns:
        Mean absolute Laplacian inside the outline, display values; difference of the median colours
        of seen and unseen views, CIE Lab. (0, 0) if all or no sides were seen.
    """
    eyes = [se3.inverse(view.camera_from_object)[:3, 3] for view in views]
    seen = [abs(float(np.degrees(np.arctan2(eye[1], eye[0])))) for eye in eyes]
    length = float(actor.size[0])
    focal = 1.6 * _LOOK_PX
    camera = PinholeCamera(_LOOK_PX, _LOOK_PX * 2 // 3, focal, focal, _LOOK_PX / 2, _LOOK_PX / 3)
    details: list[float] = []
    colours: dict[bool, list[Array]] = {True: [], False: []}
    for azimuth in (0.0, 40.0, 90.0, 140.0, 180.0):
        apart = min((abs(azimuth - one) for one in seen), default=0.0)
        if _SEEN_WITHIN < apart < _UNSEEN_BEYOND:
            continue
        turn = np.radians(azimuth)
        eye = 2.2 * length * np.array([np.cos(turn), np.sin(turn), 0.2])
        with torch.no_grad():
            picture = draw(actor.gaussians, look_at(eye, np.zeros(3)), camera, actor.low_pass)
        inside = picture.alpha.numpy() > 0.9
        rgb = np.clip(picture.rgb.numpy(), 0, 1).astype(np.float32)
        if not inside.any():
            continue
        unseen = apart >= _UNSEEN_BEYOND
        colours[unseen].append(cielab(rgb)[inside])
        if unseen:
            core = cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
            edges = np.abs(cv2.Laplacian(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), cv2.CV_32F))
            details.append(float(edges[core].mean()) if core.any() else 0.0)
    if not colours[True] or not colours[False]:
        return 0.0, 0.0
    first, second = (np.median(np.concatenate(colours[unseen]), axis=0) for unseen in (True, False))
    return float(np.mean(details)), float(np.linalg.norm(first - second))


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
            posed = actor.at(view.world_from_object)
            picture = draw(posed, view.camera_from_object, view.camera, actor.low_pass)
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
