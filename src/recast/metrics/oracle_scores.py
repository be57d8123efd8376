"""How alike a drawn vehicle and the true one are: scores, means by angle, and their file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import ArrayLike

from recast.actors.actor import Coverage
from recast.actors.insert import draw
from recast.arrays import Array, Image, Mask
from recast.cameras import PinholeCamera, box_rectangle
from recast.core.records import Record, read_record
from recast.metrics.table import Bootstrap, cluster_bootstrap
from recast.metrics.vehicle_looks import fine_energy_share
from recast.reconstruction.scores import Rectangle, capped_psnr, ssim_map
from recast.scene import SceneActor

VERSION: Literal[3] = 3
"""1 called the sides native and replaced; 2 had no sharpness."""
RECORD_FILE = "oracle_views.json"


@dataclass(frozen=True)
class Agreement:
    """An arm's image against the truth's.

    Attributes:
        psnr: dB inside the rectangle, at most 100.
        ssim: mean over the rectangle.
        mask_iou: intersection over union of the vehicle's outlines, over the whole image.
        sharpness: share of the truth's high-frequency energy where both show the vehicle, see
            `recast.metrics.vehicle_looks.fine_energy_share`.
    """

    psnr: float
    ssim: float
    mask_iou: float
    sharpness: float


def box_pixels(
    size: ArrayLike, camera_from_actor: Array, camera: PinholeCamera
) -> Rectangle | None:
    """The projected box's rectangle, clipped to the image; None where less than half is in it."""
    outline = box_rectangle(size, camera_from_actor, camera)
    if outline is None:
        return None
    limits = [camera.width, camera.height, camera.width, camera.height]
    inside = np.clip(outline, 0, limits)
    width, height = inside[2:] - inside[:2]
    if width * height < 0.5 * np.prod(outline[2:] - outline[:2]) or min(width, height) < 1:
        return None
    left, top = (int(v) for v in np.floor(inside[:2]))
    right, bottom = (int(v) for v in np.ceil(inside[2:]))
    return left, top, right, bottom


def grown(rectangle: Rectangle, margin: int, width: int, height: int) -> Rectangle:
    """The rectangle with `margin` more pixels on every side that has them."""
    left, top, right, bottom = rectangle
    return (
        max(left - margin, 0),
        max(top - margin, 0),
        min(right + margin, width),
        min(bottom + margin, height),
    )


def agreement(
    image: Image,
    truth: Image,
    rectangle: Rectangle,
    mask: Mask,
    true_mask: Mask,
    corner: tuple[int, int] = (0, 0),
) -> Agreement:
    """Score one view.

    SSIM is the mean over the rectangle of the map computed on all that is given: its 11 x 11
    windows look beyond the rectangle's edge, so that a rectangle may be smaller than a window.

    Args:
        image, truth: (H, W, 3) uint8, the rectangle and what surrounds it.
        rectangle: rectangle in pixels of these images.
        mask, true_mask: bool of the whole image.
        corner: column and row of the images' first pixel in the masks.

    Raises:
        ValueError: the rectangle holds no pixel.
    """
    left, top, right, bottom = rectangle
    if left >= right or top >= bottom:
        raise ValueError(f"agreement: the rectangle {rectangle} is empty")
    inside = (slice(top, bottom), slice(left, right))
    columns, rows = (slice(at, at + n) for at, n in zip(corner, image.shape[1::-1], strict=True))
    drawn, wanted = image.astype(np.float64) / 255, truth.astype(np.float64) / 255
    similarity = ssim_map(torch.from_numpy(drawn), torch.from_numpy(wanted)).numpy()
    return Agreement(
        psnr=capped_psnr(drawn[inside], wanted[inside]),
        ssim=float(similarity[inside].mean()),
        mask_iou=mask_iou(mask, true_mask),
        sharpness=fine_energy_share(drawn, wanted, (mask & true_mask)[rows, columns]),
    )


def mask_iou(mask: Mask, true_mask: Mask) -> float:
    """Intersection over union; 1 where both are empty."""
    union = int((mask | true_mask).sum())
    return int((mask & true_mask).sum()) / union if union else 1.0


def actor_mask(
    actor: SceneActor, camera: PinholeCamera, camera_from_world: Array, world_from_actor: Array
) -> Mask:
    """Pixels (H, W) that a vehicle drawn alone, without its shadow, covers by more than half."""
    placed = actor.gaussians.detach().transformed(torch.from_numpy(world_from_actor))
    with torch.no_grad():
        alone = draw(placed, camera_from_world, camera, actor.low_pass)
    return alone.alpha.numpy() > 0.5


MEASURES = ("psnr", "ssim", "mask_iou", "sharpness")
"""Fields of `Agreement`; higher is better for all."""

EDGES = ((0.0, 30.0), (30.0, 60.0), (60.0, 90.0), (90.0, 180.0), (60.0, 180.0), (0.0, 180.0))
"""Degrees from the nearest logged view, the lower end included: four bins, then "beyond 60" and
all views."""

SAMPLES = 20_000


@dataclass(frozen=True)
class AngleBin:
    """The views within a range of angles.

    Attributes:
        low, high: degrees from the nearest logged view, [low, high).
        views: number of views.
        baseline, candidate: means over them; None where there is none.
        difference: difference by measure, candidate minus baseline of the same view: mean and
            interval, headings drawn with replacement with all their views. Empty where there is no
            view.
        candidate_better: number of views in which the candidate actor is the better one, by
            measure.
    """

    low: float
    high: float
    views: int
    baseline: Agreement | None
    candidate: Agreement | None
    difference: Mapping[str, Bootstrap]
    candidate_better: Mapping[str, int]


def summarise(views: Sequence[OracleView], rng: np.random.Generator) -> tuple[AngleBin, ...]:
    """One `AngleBin` for each of `EDGES`."""
    return tuple(
        _bin(
            [v for v in views if low <= v.angle < high or v.angle == high == 180.0], low, high, rng
        )
        for low, high in EDGES
    )


def _bin(
    views: Sequence[OracleView], low: float, high: float, rng: np.random.Generator
) -> AngleBin:
    difference, better = {}, {}
    for measure in MEASURES:
        by_heading: dict[float, list[float]] = {}
        for view in views:
            change = getattr(view.candidate, measure) - getattr(view.baseline, measure)
            by_heading.setdefault(round(view.heading, 6), []).append(change)
        if by_heading:
            difference[measure] = cluster_bootstrap(list(by_heading.values()), rng, SAMPLES)
        better[measure] = sum(bool(change > 0) for group in by_heading.values() for change in group)
    return AngleBin(
        low=low,
        high=high,
        views=len(views),
        baseline=_mean([view.baseline for view in views]),
        candidate=_mean([view.candidate for view in views]),
        difference=difference,
        candidate_better=better,
    )


def _mean(scores: Sequence[Agreement]) -> Agreement | None:
    if not scores:
        return None
    return Agreement(*(float(np.mean([getattr(s, m) for s in scores])) for m in MEASURES))


@dataclass(frozen=True)
class OracleView:
    """One view, drawn with both actors and by the oracle.

    Attributes:
        index: number of the view, from 0; names its picture.
        camera, frame, timestamp_us: the logged frame whose camera pose is used.
        distance: metres along the road from the camera to the vehicle's box centre.
        heading: radians against the road's: 0 drives ahead of the ego, pi faces it.
        azimuth, elevation: degrees, of the camera seen from the vehicle; azimuth 0 is ahead of it.
        angle: degrees to the nearest logged view.
        rectangle: left, top, right, bottom of the box in the image, whole pixels.
        baseline, candidate: scores.
        coverage: how much of the candidate was seen by the log, mirrored or invented; None for an
            actor without shares.
    """

    index: int
    camera: str
    frame: int
    timestamp_us: int
    distance: float
    heading: float
    azimuth: float
    elevation: float
    angle: float
    rectangle: Rectangle
    baseline: Agreement
    candidate: Agreement
    coverage: Coverage | None = None

    @property
    def picture(self) -> str:
        """Name of the file with baseline, candidate and truth side by side."""
        return f"view_{self.index:03d}.png"


@dataclass(frozen=True)
class OracleViews:
    """All views of one vehicle, and what they say.

    Attributes:
        logged: how many logged images show it.
        summary: see `recast.metrics.oracle_scores.EDGES`.
        showcase: index of the view that was kept as whole images: the one furthest from any logged
            view, at the nearest distance.
    """

    track_id: str
    logged: int
    views: tuple[OracleView, ...]
    summary: tuple[AngleBin, ...]
    showcase: int

    @property
    def beyond_60(self) -> AngleBin:
        """Views at least 60 degrees from any logged one."""
        return next(b for b in self.summary if (b.low, b.high) == (60.0, 180.0))

    def to_json(self) -> dict[str, Any]:
        """Plain data with a version; the same scenes give the same bytes."""
        return {"format": "recast-oracle-views", "version": VERSION, **asdict(self)}


class _Record(Record):
    format: Literal["recast-oracle-views"]
    version: Literal[3]
    track_id: str
    logged: int
    views: tuple[OracleView, ...]
    summary: tuple[AngleBin, ...]
    showcase: int


def read_oracle_views(folder: str | Path) -> OracleViews:
    """Read what `evaluate_oracle_views` wrote.

    Raises:
        InputError: `oracle_views.json` is missing, broken, or of another version.
    """
    path = Path(folder) / RECORD_FILE
    record = read_record(path, _Record, VERSION, "run the comparison again", "recast-oracle-views")
    return OracleViews(
        record.track_id, record.logged, record.views, record.summary, record.showcase
    )
