"""Does a planner plan the same on the rendering as on the recorded image?

At the times and poses of a log's images, with ego and traffic as they were, a planner gets the
recorded images and, in another drive, those that a simulator renders in their place. Nothing else
differs, so its plans should be the same. No truth is needed: any recording can be asked. Next to
it stand what small disturbances of the recorded images move (the noise floor), and mixtures of both
images, which tell the part of the image that moves the plans.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

import cv2
import numpy as np
from PIL import Image as PilImage

from recast.arrays import Array, BoolArray, Image
from recast.cameras import CameraMount
from recast.core.diagnostics import Progress
from recast.core.errors import InputError
from recast.core.files import read_json, write_json
from recast.core.foreign import ForeignCode, read_only
from recast.dynamics import state as ego
from recast.metrics.table import rounded
from recast.planning import BasePlanner
from recast.reconstruction.scores import capped_psnr
from recast.scene.actor import painted, painted_actor
from recast.scene.street_scene import StreetScene
from recast.simulation.recorded_drive import (
    DISTURBANCES,
    Images,
    RecordedDrive,
    disturbed,
    draw_paths,
    leaves_lane,
    stops,
    what_is_ahead,
)
from recast.simulation.renderer import SensorRenderer
from recast.simulation.scene_renderer import SceneRenderer, through_lenses

NEAR, MOVED = 0.5, 2.0
"""Metres at 4 s below which two plans are the same, and above which they are not."""
WORST = 10
"""Number of moments that are shown."""
PARTS: tuple[str, ...] = (
    "vehicle alone",
    "vehicle recorded",
    "sky recorded",
    "contrast recorded",
    "spectrum recorded",
)
"""Mixtures of the recorded and the rendered image, see `mixed`."""
DENOISED = "without noise"
_GROWN = 2  # pixels by which the rendered vehicle's mask is grown
_MATCH = 0.5  # IoU from which two boxes of a detector are the same


class Detector(Protocol):
    """A detector of vehicles: this method is enough."""

    def detect(self, image: Image) -> Array:
        """Boxes (N, 4) in an image (H, W, 3) uint8 RGB: left, top, right, bottom, pixels."""


@dataclass(frozen=True)
class PlanDifference:
    """What other images do to a plan.

    Attributes:
        ade, fde: metres between the two plans, mean over the 40 waypoints and at the last (4 s).
        other_decision: whether one stops within 4 s, or leaves the recorded lane, and the other
            does not.
    """

    ade: float
    fde: float
    other_decision: bool


@dataclass(frozen=True)
class AgreementMoment:
    """One moment of a log.

    Attributes:
        timestamp_us: log time.
        speed: m/s that the ego drove.
        ahead: what is ahead, see `what_is_ahead`.
        held_out: whether training held out the images; None where that is not known.
        stops: whether the plan on the recorded images stops.
        psnr: dB between recorded and rendered images by arm, over all pixels that both show.
        differences: to the plan on the recorded images, by arm, disturbance, and "ARM: PART".
        boxes: by arm, share of a detector's boxes, on both images, that the other image has, too.
    """

    timestamp_us: int
    speed: float
    ahead: str
    held_out: bool | None
    stops: bool
    psnr: Mapping[str, float]
    differences: Mapping[str, PlanDifference]
    boxes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class AgreementScores:
    """Means over moments of one kind of image.

    Attributes:
        images: arm, disturbance, or "ARM: PART".
        kind: "all", "held out" or "trained on".
        moments: number of moments.
        psnr: mean, dB; None for disturbances and parts.
        ade, fde, median: mean ADE and FDE, median FDE, metres.
        near, moved: shares of plans with FDE below 0.5 m, and above 2 m.
        other_decision: share of plans that decide otherwise.
        boxes: mean share of a detector's boxes that both images have; None without a detector.
    """

    images: str
    kind: str
    moments: int
    psnr: float | None
    ade: float
    fde: float
    median: float
    near: float
    moved: float
    other_decision: float
    boxes: float | None = None


@dataclass(frozen=True)
class PlanAgreement:
    """A planner on the recorded and the rendered images of one log.

    Attributes:
        left_out: moments at which a camera had no image.
    """

    planner: str
    log: str
    arms: tuple[str, ...]
    moments: tuple[AgreementMoment, ...]
    left_out: int = 0

    def scores(self, images: str, kind: str = "all") -> AgreementScores | None:
        """Means for one kind of image; None where there is no such moment."""
        wanted = {"all": None, "held out": True, "trained on": False}[kind]
        moments = [one for one in self.moments if wanted is None or one.held_out is wanted]
        if not moments or images not in moments[0].differences:
            return None
        apart = [one.differences[images] for one in moments]
        fde = np.array([one.fde for one in apart])
        shown = images in self.arms
        return AgreementScores(
            images,
            kind,
            len(moments),
            float(np.mean([one.psnr[images] for one in moments])) if shown else None,
            float(np.mean([one.ade for one in apart])),
            float(fde.mean()),
            float(np.median(fde)),
            float((fde < NEAR).mean()),
            float((fde > MOVED).mean()),
            float(np.mean([one.other_decision for one in apart])),
            float(np.mean([one.boxes[images] for one in moments]))
            if shown and moments[0].boxes
            else None,
        )

    @property
    def table(self) -> list[AgreementScores]:
        """All scores: arms, each by what training saw too, disturbances, parts."""
        names = list(self.moments[0].differences) if self.moments else []
        found = []
        for name in names:
            kinds = ("all", "held out", "trained on") if name in self.arms else ("all",)
            found += [self.scores(name, kind) for kind in kinds]
        return [one for one in found if one is not None]

    @property
    def floor(self) -> float:
        """Share of plans that a shift of the recorded images by one pixel moves."""
        found = self.scores(DISTURBANCES[0])
        return 0.0 if found is None else found.moved

    def worst(self, most: int = WORST) -> list[AgreementMoment]:
        """The moments with the largest FDE of an arm, the largest first."""
        far = {
            one.timestamp_us: max(one.differences[a].fde for a in self.arms) for one in self.moments
        }
        return sorted(self.moments, key=lambda one: -far[one.timestamp_us])[:most]

    def to_json(self) -> dict[str, Any]:
        """Plain data, rounded to six decimals."""
        found = {"version": 1, **asdict(self), "table": [asdict(one) for one in self.table]}
        return dict(rounded(found))

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> PlanAgreement:
        """What `to_json` wrote."""
        moments = tuple(
            AgreementMoment(
                **{
                    **one,
                    "differences": {
                        key: PlanDifference(**value) for key, value in one["differences"].items()
                    },
                }
            )
            for one in record["moments"]
        )
        arms = tuple(record["arms"])
        return cls(record["planner"], record["log"], arms, moments, record["left_out"])


Pictures = dict[int, dict[str, Image]]
"""Images with the plans drawn in, by log time, then by arm; "recorded" is one of them."""
RECORDED = "recorded"


def plan_agreement(
    planner: BasePlanner,
    drive: RecordedDrive,
    renderers: Mapping[str, SensorRenderer],
    *,
    every: float = 0.5,
    masks: Mapping[str, SensorRenderer] | None = None,
    held_out: Callable[[str, int], bool | None] = lambda camera, frame: None,
    detector: Detector | None = None,
    progress: Progress | None = None,
) -> tuple[PlanAgreement, Pictures]:
    """Let a planner plan on the recorded and the rendered images of a drive.

    Each kind of image is a drive of its own for the planner, so that what it remembers is of that
    kind, too. A moment at which one of its cameras has no image is left out for all.

    Args:
        renderers: by arm, renderers of the mounts of `drive`.
        masks: by arm, the renderers of `mask_renderer`: then the parts are measured, too.
        every: seconds between the moments.
        held_out: function of a log camera and its frame that says whether training held it out.
        detector: detector whose boxes on both images are compared.

    Returns:
        The measure, and pictures of its `worst` moments.

    Raises:
        InputError: the planner looks at no images, or no moment has all of them.
        ValueError: the planner's answer is no plan.
    """
    if not drive.names:
        problem = "looks at no images, so that rendered ones change nothing"
        raise InputError("planner", planner.name, problem, "name a planner that does")
    times = drive.times(every)
    whole = [t for t in times if all(drive.frame(name, t) is not None for name in drive.names)]
    if not whole:
        problem = "at no moment has each camera of the planner an image"
        raise InputError(drive.log.name, "cameras", problem, "check the images' timestamps")
    with TemporaryDirectory() as folder:
        spool, psnr = _Spool(Path(folder)), []
        for index, time_us in enumerate(whole):
            recorded, shown = drive.images(time_us), drive.shown(time_us)
            spool.keep(RECORDED, index, recorded)
            rendered = {arm: drive.rendered(one, time_us) for arm, one in renderers.items()}
            psnr.append({arm: _psnr(recorded, images, shown) for arm, images in rendered.items()})
            for arm, images in rendered.items():
                spool.keep(f"{arm} shows", index, images)
            for arm, renderer in (masks or {}).items():
                spool.keep(f"{arm} mask", index, drive.rendered(renderer, time_us))
            if progress is not None:
                progress(index + 1, len(whole))
        return _compared(
            planner,
            drive,
            whole,
            spool,
            psnr,
            list(renderers),
            masks is not None,
            len(times) - len(whole),
            held_out,
            detector,
        )


class _Spool:
    """Images on disk: those of a long drive do not fit into memory."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._kinds: dict[str, int] = {}

    def keep(self, kind: str, index: int, images: Images) -> None:
        self._names = sorted(images)
        self._kinds.setdefault(kind, len(self._kinds))
        for number, name in enumerate(self._names):
            np.save(self._path(kind, index, number), images[name])

    def take(self, kind: str, index: int) -> dict[str, Image]:
        found = enumerate(self._names)
        return {name: np.load(self._path(kind, index, number)) for number, name in found}

    def _path(self, kind: str, index: int, number: int) -> Path:
        return self._folder / f"{self._kinds[kind]}-{index}-{number}.npy"


def _compared(
    planner: BasePlanner,
    drive: RecordedDrive,
    times: Sequence[int],
    spool: _Spool,
    psnr: Sequence[Mapping[str, float]],
    arms: Sequence[str],
    parts: bool,
    left_out: int,
    held_out: Callable[[str, int], bool | None],
    detector: Detector | None,
) -> tuple[PlanAgreement, Pictures]:
    def taken(arm: str) -> Callable[[int, int], Images]:
        return lambda index, _: spool.take(f"{arm} shows", index)

    def changed(name: str) -> Callable[[int, int], Images]:
        return lambda index, _: disturbed(name, spool.take(RECORDED, index), index)

    def mixture(arm: str, part: str) -> Callable[[int, int], Images]:
        kinds = (RECORDED, f"{arm} shows", f"{arm} mask")
        return lambda index, _: mixed(part, *(spool.take(kind, index) for kind in kinds))

    kinds = {arm: taken(arm) for arm in arms}
    kinds |= {name: changed(name) for name in DISTURBANCES}
    if parts:
        kinds[DENOISED] = lambda index, _: without_noise(spool.take(RECORDED, index))
        kinds |= {f"{arm}: {part}": mixture(arm, part) for arm in arms for part in PARTS}
    seen = list(drive.plans(planner, times, lambda index, _: spool.take(RECORDED, index)))
    others = {
        name: [plan for _, plan in drive.plans(planner, times, images)]
        for name, images in kinds.items()
    }
    moments = []
    for index, (time_us, (observed, plan)) in enumerate(zip(times, seen, strict=True)):
        driven, recorded = drive.driven(time_us), spool.take(RECORDED, index)
        kept = [held_out(*frame) for n in drive.names if (frame := drive.frame(n, time_us))]
        moments.append(
            AgreementMoment(
                time_us,
                float(observed.ego[ego.VX]),
                what_is_ahead(observed, drive.route),
                None if None in kept else all(kept),
                stops(plan),
                psnr[index],
                {k: _difference(plan, v[index], driven) for k, v in others.items()},
                {}
                if detector is None
                else {a: _boxes(detector, recorded, spool.take(f"{a} shows", index)) for a in arms},
            )
        )
    found = PlanAgreement(planner.name, drive.log.name, tuple(arms), tuple(moments), left_out)
    pictures: Pictures = {}
    for one in found.worst():
        index = times.index(one.timestamp_us)
        plan = seen[index][1]
        pictures[one.timestamp_us] = {
            RECORDED: draw_paths(drive, spool.take(RECORDED, index), {_ON_RECORDED: plan})
        }
        for arm in arms:
            paths = {_ON_RECORDED: plan, _ON_RENDERED: others[arm][index]}
            pictures[one.timestamp_us][arm] = draw_paths(
                drive, spool.take(f"{arm} shows", index), paths
            )
    return found, pictures


AGREEMENT_FILE = "metrics.json"


def write_agreement(found: PlanAgreement, pictures: Pictures, folder: Path) -> None:
    """Write `metrics.json`, and the pictures of its worst moments: `pictures/TIME-NUMBER.png`, the
    recorded image (number 0), then each arm's."""
    write_json(folder / AGREEMENT_FILE, found.to_json())
    for time_us, images in pictures.items():
        for number, image in enumerate(images.values()):
            path = picture_path(folder, time_us, number)
            path.parent.mkdir(exist_ok=True)
            PilImage.fromarray(image).save(path, format="PNG")


def picture_path(folder: Path, time_us: int, number: int) -> Path:
    """A picture of `write_agreement`."""
    return folder / "pictures" / f"{time_us}-{number}.png"


def read_agreement(folder: Path) -> PlanAgreement:
    """Read what `write_agreement` wrote.

    Raises:
        InputError: the file is missing or damaged.
    """
    path = folder / AGREEMENT_FILE
    record = read_json(path)
    try:
        return PlanAgreement.from_json(record)
    except (KeyError, TypeError, AttributeError) as error:
        problem = f"is no plan agreement: {type(error).__name__} {error}"
        raise InputError(path, "moments", problem, "remove the folder and measure again") from None


_ON_RECORDED, _ON_RENDERED = (44, 160, 44), (214, 39, 40)  # green and red


def _difference(plan: Array, other: Array, driven: Array) -> PlanDifference:
    apart = np.linalg.norm(plan[:, :2] - other[:, :2], axis=1)
    decides = [(stops(one), leaves_lane(one, driven)) for one in (plan, other)]
    return PlanDifference(float(apart.mean()), float(apart[-1]), decides[0] != decides[1])


def _psnr(recorded: Images, rendered: Images, shown: Mapping[str, BoolArray]) -> float:
    pixels = [
        np.concatenate([images[name][mask] for name, mask in shown.items()]) / 255
        for images in (rendered, recorded)
    ]
    return capped_psnr(pixels[0], pixels[1])


def renderer_of(scene: StreetScene, mounts: Mapping[str, CameraMount]) -> SensorRenderer:
    """A renderer of a street, of cameras of any lens."""
    return through_lenses(mounts, lambda pinholes: SceneRenderer(scene, pinholes))


def mask_renderer(
    scene: StreetScene, track_id: str | None, mounts: Mapping[str, CameraMount]
) -> SensorRenderer:
    """A renderer whose red is how much of a vehicle a pixel shows, and whose green is how much of
    anything: the rest is sky."""
    return renderer_of(_masks_of(scene, track_id), mounts)


def _masks_of(scene: StreetScene, track_id: str | None) -> StreetScene:
    street, vehicle = (0.0, 1.0, 0.0), (1.0, 1.0, 0.0)

    def colour(key: str) -> tuple[float, float, float]:
        return vehicle if key == track_id else street

    actors = {key: painted_actor(actor, colour(key), street) for key, actor in scene.actors.items()}
    black = replace(scene.sky, colours=scene.sky.colours * 0)
    return replace(
        scene, background=painted(scene.background, street), actors=actors, sky=black, exposures={}
    )


def mixed(part: str, recorded: Images, rendered: Images, masks: Images) -> dict[str, Image]:
    """Mixtures of two images.

    Args:
        part: one of `PARTS`: the recorded image with the rendered vehicle alone; or the
            rendered image with the recorded vehicle, sky, mean and contrast of each colour, or
            spectrum: the mean power of its luminance at each spatial frequency. The vehicle is what
            its mask shows, grown by 2 pixels.
        masks: what `mask_renderer` draws.
    """
    return {name: _PARTS[part](one, rendered[name], masks[name]) for name, one in recorded.items()}


def _vehicle(mask: Image) -> BoolArray:
    shown = (mask[..., 0] > 25).astype(np.uint8)
    return np.asarray(cv2.dilate(shown, np.ones((2 * _GROWN + 1,) * 2, np.uint8)) > 0)[..., None]


def _with_moments(recorded: Image, rendered: Image) -> Image:
    """The rendering with the recorded image's mean and standard deviation, colour by colour."""
    a, b = recorded.astype(np.float64), rendered.astype(np.float64)
    gain = a.std(axis=(0, 1)) / np.maximum(b.std(axis=(0, 1)), 1.0)
    return _levels((b - b.mean(axis=(0, 1))) * gain + a.mean(axis=(0, 1)))


def _with_spectrum(recorded: Image, rendered: Image) -> Image:
    """The rendering, blurred or sharpened to the recorded power at each spatial frequency."""
    height, width = recorded.shape[:2]
    radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None])
    ring = np.minimum((radius * min(height, width)).astype(int), min(height, width) // 2)

    def power(image: Image) -> Array:
        grey = image.astype(np.float64).mean(axis=-1)
        there = np.abs(np.fft.rfft2(grey - grey.mean())) ** 2
        return np.bincount(ring.ravel(), there.ravel()) / np.bincount(ring.ravel())

    gain = np.sqrt(power(recorded) / np.maximum(power(rendered), 1e-9)).clip(0.25, 4.0)
    gain[0] = 1.0
    waves = np.fft.rfft2(rendered.astype(np.float64), axes=(0, 1)) * gain[ring][..., None]
    return _levels(np.fft.irfft2(waves, s=(height, width), axes=(0, 1)))


def _levels(values: Array) -> Image:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


_PARTS: dict[str, Callable[[Image, Image, Image], Image]] = dict(
    zip(
        PARTS,
        (
            lambda a, b, mask: np.where(_vehicle(mask), b, a),
            lambda a, b, mask: np.where(_vehicle(mask), a, b),
            lambda a, b, mask: np.where(mask[..., 1:2] < 128, a, b),
            lambda a, b, mask: _with_moments(a, b),
            lambda a, b, mask: _with_spectrum(a, b),
        ),
        strict=True,
    )
)


def without_noise(images: Images) -> dict[str, Image]:
    """Images without the noise of a camera: what lies within three standard deviations of it is
    averaged, the noise estimated from the differences of neighbouring pixels."""
    found = {}
    for name, image in images.items():
        grey = image.astype(np.float64).mean(axis=-1)
        twice = grey[1:, 1:] - grey[1:, :-1] - grey[:-1, 1:] + grey[:-1, :-1]
        sigma = float(np.median(np.abs(twice))) / 0.6745 / 2 * np.sqrt(3.0)
        found[name] = np.asarray(cv2.bilateralFilter(image, 5, max(3 * sigma, 1.0), 2.0), np.uint8)
    return found


def _boxes(detector: Detector, recorded: Images, rendered: Images) -> float:
    """Share of all boxes on both images that the other image has, too; 1 if neither has any."""
    matched = total = 0
    for name, image in recorded.items():
        one, other = (_detected(detector, shown) for shown in (image, rendered[name]))
        total += len(one) + len(other)
        iou = _iou(one, other)
        if iou.size:
            matched += int((iou.max(1) > _MATCH).sum() + (iou.max(0) > _MATCH).sum())
    return matched / total if total else 1.0


def _detected(detector: Detector, image: Image) -> Array:
    who = f"detector {type(detector).__name__}"
    with ForeignCode(who).call("detect"):
        boxes = np.array(detector.detect(read_only(image)), np.float64)
    if boxes.size == 0:
        return np.zeros((0, 4))
    if boxes.ndim != 2 or boxes.shape[1] != 4 or not np.isfinite(boxes).all():
        problem = f"returned boxes of shape {boxes.shape}, or with values that are not finite"
        raise InputError(who, "boxes", problem, "return (N, 4): left, top, right, bottom, pixels")
    return boxes


def _iou(one: Array, other: Array) -> Array:
    low = np.maximum(one[:, None, :2], other[None, :, :2])
    high = np.minimum(one[:, None, 2:], other[None, :, 2:])
    common = np.prod(np.maximum(high - low, 0.0), axis=-1)
    areas = [np.prod(boxes[:, 2:] - boxes[:, :2], axis=-1) for boxes in (one, other)]
    return common / np.maximum(areas[0][:, None] + areas[1][None] - common, 1e-9)
