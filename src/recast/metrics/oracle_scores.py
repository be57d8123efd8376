"""How alike a drawn vehicle and the true one are: scores, means by angle, and their file.

Beside pixels: colour of the paint, sharpness, structure, none of which needs weights. Each is a
figure that a blurred, ghosted or wrongly coloured vehicle changes where PSNR and SSIM hardly do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np
import torch
from numpy.typing import ArrayLike

from recast.actors.actor import Coverage
from recast.actors.insert import draw
from recast.arrays import Array, Image, Mask
from recast.cameras import PinholeCamera, box_rectangle
from recast.core.records import Record, read_record
from recast.geometry.colour import cielab, linear_to_srgb, srgb_to_linear
from recast.metrics.table import Bootstrap, cluster_bootstrap
from recast.reconstruction.scores import Rectangle, capped_psnr, ssim_map
from recast.scene import SceneActor

if TYPE_CHECKING:
    from recast.metrics.actor_scores import ScoredCutout

VERSION: Literal[3] = 3
"""1 called the sides native and replaced; 2 had no sharpness."""
RECORD_FILE = "oracle_views.json"
_FINE, _COARSE = 0.004, 0.016  # of the vehicle's longer side: what lies between is sharpness
_EDGE = 0.02  # share of it beside the outline that does not count
_GAIN_RANGE = 0.6, 1.7  # of light by which photographs of one vehicle may differ
_SCALES, _CELLS, _ANGLES = 3, 16, 8
_STEADY = 0.02  # gradient below which a cell has no direction


@dataclass(frozen=True)
class Agreement:
    """An arm's image against the truth's.

    Attributes:
        psnr: dB inside the rectangle, at most 100.
        ssim: mean over the rectangle.
        mask_iou: intersection over union of the vehicle's outlines, over the whole image.
        sharpness: share of the truth's high-frequency energy where both show the vehicle, see
            `fine_energy_share`.
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
    actor = actor.stepped_at(world_from_actor)
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


def light_gain(first: Array, first_mask: Mask, other: Array, other_mask: Mask) -> Array:
    """(3,) factors of linear light that bring a photograph to the light of the first one.

    Both show one vehicle at one place: what surrounds it at the bottom of the picture, the floor,
    has the same colour in both. Beyond plausible factors, or without surroundings, there is none.

    Args:
        first, other: (H, W, 3) display values in [0, 1], with the surroundings.
        first_mask, other_mask: (H, W) pixels on the vehicle.
    """
    floors = []
    for image, mask in ((first, first_mask), (other, other_mask)):
        beside = ~cv2.dilate(mask.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool)
        beside[: round(0.6 * len(beside))] = False
        if beside.sum() < 50:
            return np.ones(3)
        floors.append(np.median(srgb_to_linear(image[beside]), axis=0))
    gain = floors[0] / np.maximum(floors[1], 1e-3)
    low, high = _GAIN_RANGE
    return np.asarray(gain if low < gain.min() and gain.max() < high else np.ones(3))


def paint_distance(shown: Array, truth: Array, gain: Array) -> float:
    """CIE76 distance of the paints (3,) of render and photograph, both CIE Lab.

    Args:
        gain: (3,) factors of the photograph's linear light, see `light_gain`.
    """
    display = cv2.cvtColor(truth.reshape(1, 1, 3).astype(np.float32), cv2.COLOR_LAB2RGB)
    lit = linear_to_srgb(srgb_to_linear(np.asarray(display, np.float64)) * gain)
    return float(np.linalg.norm(shown - cielab(lit)[0, 0]))


def fine_energy_share(shown: Array, truth: Array, mask: Mask) -> float:
    """Share of the truth's high-frequency energy that an image has: 1 is as sharp, 0 is fog.

    Energy of light between two widths of Gaussians, in proportion to the vehicle's size, so that
    noise and JPEG blocks of a pixel or two do not count. More than the truth's energy counts as 1:
    the figure tells what is missing.

    Args:
        shown, truth: (H, W, 3) display values in [0, 1].
        mask: (H, W) pixels that both show; those near its outline are left out.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return 0.0
    side = float(max(np.ptp(rows), np.ptp(columns)) + 1)
    reach = max(1, round(_EDGE * side))
    inner = cv2.erode(mask.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
    if inner.sum() < 50:
        return 0.0
    energies = []
    for image in (shown, truth):
        light = cielab(image)[..., 0]
        fine, coarse = (
            cv2.GaussianBlur(light, (0, 0), max(s * side, 0.6)) for s in (_FINE, _COARSE)
        )
        energies.append(float(((fine - coarse)[inner] ** 2).mean()))
    return min(energies[0] / max(energies[1], 1e-9), 1.0)


def sharpness(shown: ScoredCutout, truth: ScoredCutout) -> float:
    """`fine_energy_share` where both vehicles are."""
    return fine_energy_share(shown.rgb, truth.rgb, shown.mask & truth.mask)


def structure_distance(shown: ScoredCutout, truth: ScoredCutout) -> float:
    """Distance in [0, 1] of what the pictures show, in cells at several scales; 0 is the same.

    Each cell has a histogram of edge directions weighed by their strength, the mean colour and the
    cover of the outline; cells are compared with a tolerance of a cell, so that a part that is a
    little aside costs less than one that is missing. Not a network: it ranks blur, ghosts, colours
    and wrong bodies, but knows nothing of what a lamp is.
    """
    rows, columns = (np.flatnonzero((shown.mask | truth.mask).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return 0.0
    window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    total = 0.0
    for scale in range(_SCALES):
        cells = _CELLS * 2**scale // 2
        one, other = (_cells(c.rgb[window], c.alpha[window], cells) for c in (shown, truth))
        covered = np.maximum(one[..., -1], other[..., -1]) > 0.1
        # the smaller of both ways: each cell against the nearest ones of the other
        apart = (_nearest_cell(one, other) + _nearest_cell(other, one)) / 2
        total += float(apart[covered].mean()) if covered.any() else 0.0
    return total / _SCALES


def _cells(rgb: Array, alpha: Array, cells: int) -> Array:
    """(cells, cells, F) features of a picture (H, W, 3) before black with alpha (H, W)."""
    side = cells * 12
    size = (side, side)
    small = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.float64)
    lab = cielab(small) / 100.0
    cover = cv2.resize(alpha.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    right, down = (cv2.Sobel(lab[..., 0], cv2.CV_64F, *d, ksize=3) / 4 for d in ((1, 0), (0, 1)))
    strength = np.hypot(right, down)
    angle = np.arctan2(down, right) % np.pi / np.pi * _ANGLES
    layers = [
        strength * np.maximum(1 - np.minimum(np.abs(angle - k), _ANGLES - np.abs(angle - k)), 0)
        for k in range(_ANGLES)
    ]
    edges = np.stack(
        [cv2.resize(one, (cells, cells), interpolation=cv2.INTER_AREA) for one in layers], -1
    )
    edges = edges / (np.linalg.norm(edges, axis=-1, keepdims=True) + _STEADY)
    rest = cv2.resize(np.dstack([2.0 * lab, cover]), (cells, cells), interpolation=cv2.INTER_AREA)
    return np.concatenate([edges, rest], axis=-1)


def _nearest_cell(one: Array, other: Array) -> Array:
    """(N, N) distance of each cell of one to the most alike of nine cells of the other."""
    padded = np.pad(other, ((1, 1), (1, 1), (0, 0)), mode="edge")
    size = one.shape[0]
    away = [
        np.sqrt(((one - padded[y : y + size, x : x + size]) ** 2).sum(axis=-1))
        + 0.05 * (x != 1 or y != 1)
        for y in range(3)
        for x in range(3)
    ]
    return np.asarray(np.minimum(np.min(away, axis=0) / np.sqrt(2.0), 1.0))
