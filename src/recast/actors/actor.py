"""A registered vehicle: where its looks come from, seen, mirrored or invented, and its record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.actors.generate import PEOPLE_GENERATOR, Asset
from recast.actors.icp import Fit
from recast.actors.observation import MaskQuality, Observation
from recast.arrays import Array
from recast.cameras import PinholeCamera, box_rectangle
from recast.core.brief import Brief
from recast.core.records import Record
from recast.geometry import se3
from recast.logs import Trajectory
from recast.logs.checks import BOX_SIDE
from recast.scene import StreetScene
from recast.scene.actor import BLACK, DrawnActor, painted, painted_actor
from recast.scene.deformation import Gait
from recast.scene.light.sun import DIRECTIONS
from recast.splats import (
    Gaussians,
    LowPass,
    concatenate,
    freeze,
    morton_order,
    pick_device,
    rasterize_frozen,
)

UNEVEN = 1.6
"""Brightness of one side over the other from which on a report says so; cars are painted alike on
both, and the template's are within 1.1."""
LEAST_PIXELS = 1.0
"""A vehicle of which an image shows less than this is not visible there."""
_PHASES = np.arange(8) / 8  # of a gait, whose limbs reach out of the pose that is stored
_REACH = 3.5  # deviations: at 3.33 even an opaque Gaussian falls below the 1/255 that is drawn
_MARGIN = 3  # pixels by which the low-pass filter may widen a Gaussian
_LEAST_FAR = 1.0  # metres: beyond the near plane, also for what is behind the camera


@dataclass(frozen=True)
class Shares:
    """Where each of N Gaussians comes from; with the invented share they add up to one."""

    seen: Tensor  # (N,) float32 in [0, 1], share from images of the Gaussian's own side
    mirrored: Tensor  # (N,) float32 in [0, 1], share from images of the other side

    def __len__(self) -> int:
        return len(self.seen)

    @property
    def invented(self) -> Tensor:
        """(N,) float32 in [0, 1], from the generator alone."""
        return (1 - self.seen - self.mirrored).clamp(0, 1)

    @property
    def columns(self) -> Tensor:
        """(N, 3) seen, mirrored, invented: as colours, red, green and blue."""
        return torch.stack([self.seen, self.mirrored, self.invented], dim=-1)

    def select(self, index: Tensor) -> Shares:
        """Those of the Gaussians at `index`: (M,) int64 or a (N,) bool mask."""
        return Shares(self.seen[index], self.mirrored[index])

    def fault(self, count: int) -> tuple[str, str] | None:
        """The field at fault and what is wrong with it; None for shares of `count` Gaussians."""
        for name in ("seen", "mirrored"):
            value: Tensor = getattr(self, name)
            if tuple(value.shape) != (count,) or value.dtype != torch.float32:
                return (
                    name,
                    f"shape {tuple(value.shape)} {value.dtype}, expected ({count},) float32",
                )
            if not bool(((value >= 0) & (value <= 1)).all()):  # also NaN
                return name, "holds values outside [0, 1]"
        if not bool((self.seen + self.mirrored <= 1 + 1e-5).all()):
            return "mirrored", "the sum of seen and mirrored exceeds 1"
        return None


@dataclass(frozen=True)
class Coverage:
    """Where the looks of a visible vehicle come from."""

    pixels: float  # visible area of the vehicle, 0 or at least `LEAST_PIXELS`
    # seen, mirrored, invented: means over that area; they add up to 1, or are 0 where pixels is.
    seen: float
    mirrored: float
    invented: float

    @classmethod
    def of(cls, areas: Array) -> Coverage:
        """The coverage of an image from the areas (3,) in pixels that come from each."""
        pixels = float(areas.sum())
        if pixels < LEAST_PIXELS:
            return NOTHING
        return cls(pixels, *(float(area) / pixels for area in areas))

    @classmethod
    def mean(cls, several: Iterable[Coverage]) -> Coverage:
        """The coverage of several images: mean area, and shares of it, over those that show it."""
        rows = np.array([astuple(one) for one in several if one.pixels > 0]).reshape(-1, 4)
        return NOTHING if len(rows) == 0 else cls.of((rows[:, :1] * rows[:, 1:]).mean(axis=0))


NOTHING = Coverage(0.0, 0.0, 0.0, 0.0)
"""Coverage of an image that does not show the vehicle."""


class CoverageMeter:
    """Measures the coverage of a vehicle in images of a scene, without drawing the images.

    The vehicle is drawn with its shares as colours, behind black: what lies nearer to the camera in
    the scene. Only the part of the image that shows the vehicle is drawn, and nothing beyond it.

    Args:
        scene: scene with the vehicle, see `recast.actors.insert`.
        track_id, shares: the vehicle, and the shares of its Gaussians.
        device: device to draw on, see `recast.splats.pick_device`.

    Raises:
        InputError: there is no such device, or gsplat is missing.
        ValueError: the scene has no such vehicle, or one of another number of Gaussians.
    """

    def __init__(
        self, scene: StreetScene, track_id: str, shares: Shares, device: str = "auto"
    ) -> None:
        if track_id not in scene.actors or len(scene.actors[track_id].gaussians) != len(shares):
            raise ValueError(f"CoverageMeter: {len(shares)} shares of track {track_id}")
        place = pick_device(device)
        vehicle = scene.actors[track_id]
        self._track_id, self._standing = track_id, scene.standing
        shown = painted_actor(vehicle, shares.columns, BLACK)
        gaussians = shown.gaussians
        gait = shown.gait
        shapes = [gaussians] if gait is None else [gait.posed(gaussians, t) for t in _PHASES]
        everywhere = concatenate(shapes)
        self._means = everywhere.means.to(place)
        self._centre, self._size = _bounds(everywhere)
        background = painted(scene.background, BLACK)
        ordered = background.select(morton_order(background.means)).to(place)
        self._street = freeze(ordered, scene.low_pass)
        self._parts = {
            key: DrawnActor(shown if key == track_id else painted_actor(actor, BLACK, BLACK), place)
            for key, actor in scene.actors.items()
        }

    def measure(
        self,
        camera: PinholeCamera,
        camera_from_world: Array,
        poses: Mapping[str, Array],
        shown: NDArray[np.bool_] | None = None,
    ) -> Coverage:
        """Coverage in one image.

        Args:
            camera: rectified camera.
            camera_from_world: (4, 4).
            poses: `world_from_actor` (4, 4) by track id; parked vehicles that it does not name
                stand where they are.
            shown: (H, W), pixels that are not black whatever is there; all if None.
        """
        poses = {**self._standing, **poses}
        camera_from_vehicle = np.asarray(camera_from_world) @ poses[self._track_id]
        box = camera_from_vehicle @ se3.from_rotation_translation(np.eye(3), self._centre)
        outline = box_rectangle(self._size, box, camera)
        if outline is None:
            return NOTHING
        limits = [camera.width, camera.height]
        left, top = (int(v) for v in np.floor(outline[:2] - _MARGIN).clip(0, limits))
        right, bottom = (int(v) for v in np.ceil(outline[2:] + _MARGIN).clip(0, limits))
        if left >= right or top >= bottom:
            return NOTHING
        areas = self._areas(
            camera.cropped(left, top, right - left, bottom - top),
            np.asarray(camera_from_world),
            poses,
        )
        if shown is not None:
            areas = areas * torch.from_numpy(shown[top:bottom, left:right, None]).to(areas)
        return Coverage.of(areas.sum(dim=(0, 1)).double().cpu().numpy())

    def _areas(
        self, camera: PinholeCamera, camera_from_world: Array, poses: Mapping[str, Array]
    ) -> Tensor:
        """(H, W, 3) share of each pixel that shows what was seen, mirrored, invented."""
        view = torch.from_numpy(np.asarray(camera_from_world, np.float64))
        row = view[2] @ torch.from_numpy(np.array(poses[self._track_id], np.float64))
        depths = self._means @ row[:3].to(self._means) + float(row[3])
        # Of this depth's rounding in float32.
        farthest = max(float(depths.max()) * (1 + 1e-5), _LEAST_FAR)
        parts = [(self._street, torch.eye(4, dtype=torch.float64))]
        for key, pose in poses.items():
            place = torch.from_numpy(np.array(pose, np.float64))
            if key in self._parts:
                parts += [(part, place) for part in self._parts[key].at(pose, None, None)]
        K = torch.from_numpy(camera.matrix).float()
        return rasterize_frozen(parts, view, K, camera.width, camera.height, far=farthest).rgb


def _reach(gaussians: Gaussians) -> Tensor:
    """(N,) metres from its centre beyond which a Gaussian is not drawn."""
    return _REACH * gaussians.log_scales.max(dim=1).values.exp()


def _bounds(gaussians: Gaussians) -> tuple[Array, Array]:
    """Centre (3,) and size (3,) of the box around all that is drawn."""
    reach = _reach(gaussians)[:, None]
    low = (gaussians.means - reach).amin(dim=0).double().cpu().numpy()
    high = (gaussians.means + reach).amax(dim=0).double().cpu().numpy()
    return (low + high) / 2, high - low


def triple(vector: Iterable[float]) -> tuple[float, float, float]:
    """Three numbers as records hold them."""
    x, y, z = (float(value) for value in vector)
    return x, y, z


class FrontEvidence(Record):
    """Why the asset faces the way it does.

    Attributes:
        votes: evidence for the declared forward axis by kind, in units; negative speaks against.
        flipped: whether the asset was turned half around.
        heading_agreement: cosine between the label's heading and the track's motion; 0 = stands.
        margin: absolute sum of the votes; below 1 the choice is doubtful.
    """

    votes: dict[str, float]
    flipped: bool
    heading_agreement: float
    margin: float


class RegistrationReport(Record):
    """Residuals and parameters of the registration.

    Attributes:
        axes: convention the asset came in.
        initial_scale: asset units to metres, from the length of the box.
        initial_yaw: radians, found by the search over the circle, before any half turn.
        width_over_box, height_over_box: extents after the initial scale over those of the box.
        front: see `FrontEvidence`.
        before, after: LiDAR-to-actor distances before and after ICP.
        icp_scale, icp_yaw, icp_translation: factor, yaw (radians) and translation (metres) that ICP
            found.
        icp_iterations: number of iterations that ICP did.
        icp_converged: whether ICP stopped by its tolerance, see `IcpResult`.
        ground_gap: metres by which ICP would have lifted the wheels off the box's ground plane had
            it been free to.
        lidar_points: number of LiDAR points on the track, all sweeps.
        lidar_by_side: number of LiDAR points near each face of the box.
        floaters: number of Gaussians beside the vehicle that were left out.
        left_over_right: brightness of what faces left over that of what faces right, linear light.
    """

    axes: str
    initial_scale: float
    initial_yaw: float
    width_over_box: float
    height_over_box: float
    front: FrontEvidence
    before: Fit
    after: Fit
    icp_scale: float
    icp_yaw: float
    icp_translation: tuple[float, float, float]
    icp_iterations: int
    icp_converged: bool
    ground_gap: float
    lidar_points: int
    lidar_by_side: dict[str, int]
    floaters: int = 0
    left_over_right: float = 1.0

    def explain(self) -> str:
        """A few lines for people."""
        faults = [f"left out {self.floaters} floating Gaussians"] if self.floaters else []
        ratio = max(self.left_over_right, 1 / self.left_over_right)
        if ratio > UNEVEN:
            brighter = "left" if self.left_over_right > 1 else "right"
            faults.append(f"{brighter} side {ratio:.1f} times as bright: light may be baked in")
        sides = ", ".join(f"{side} {count}" for side, count in self.lidar_by_side.items())
        if self.icp_iterations == 0:  # a person
            first = []
            last = f"placed by its box, of whose height it fills {self.height_over_box:.2f}"
        else:
            votes = ", ".join(f"{kind} {vote:+.1f}" for kind, vote in self.front.votes.items())
            turned = "turned by 180 degrees" if self.front.flipped else "kept"
            ended = "converged" if self.icp_converged else "stopped"
            first = [
                f"scale {self.initial_scale:.3f} from the length; fills {self.width_over_box:.2f} "
                f"of the box's width, {self.height_over_box:.2f} of its height",
                f"front {turned} ({votes})",
            ]
            last = (
                f"ICP {ended} after {self.icp_iterations} steps: scale {self.icp_scale:.3f}, yaw "
                f"{np.degrees(self.icp_yaw):.1f} degrees"
            )
        return "\n".join(
            [
                *faults,
                *first,
                f"LiDAR to actor, median {self.before.median:.3f} -> {self.after.median:.3f} m, "
                f"mean {self.before.mean:.3f} -> {self.after.mean:.3f} m, within 0.10 m "
                f"{self.before.inlier_share:.0%} -> {self.after.inlier_share:.0%}",
                f"{last}; LiDAR points: {sides}",
            ]
        )


class SourceView(Record):
    """One image that an actor was made from.

    Attributes:
        camera, frame, timestamp_us: camera name, frame number and time of the image.
        azimuth: direction to the camera in the actor frame, radians.
    """

    camera: str
    frame: int
    timestamp_us: int
    azimuth: float


class CandidateScore(Record):
    """How well a registered vehicle explains what the log knows; None where it knows nothing.

    Attributes:
        outline: mean overlap (IoU) with the masks of many images.
        colour: mean absolute difference of display values where both are, after one gain.
        lidar: share of the LiDAR points within 10 cm of its surface; `lidar_median` in metres.
        free: share of its surface in space that LiDAR rays passed through.
        detail: fine structure of views that no image has, display values; 0 is fog.
        apart: difference of its colours there from those of the sides that were seen, CIE Lab.
        total: all of these in units; the largest is taken.
        fits: whether outline and LiDAR speak of the same kind of vehicle.
    """

    outline: float | None
    colour: float | None
    lidar: float | None
    lidar_median: float | None
    free: float
    detail: float = 0.0
    apart: float = 0.0
    total: float
    fits: bool


class CandidateRecord(Record):
    """One of the vehicles that an actor was chosen from.

    Attributes:
        generator, seed: what made it.
        label: what tells it from the others of its generator; or why there is none.
        score: score of the candidate; None where it could not be made.
        chosen: whether this candidate is the actor.
    """

    generator: str
    seed: int
    label: str
    score: CandidateScore | None = None
    chosen: bool = False

    def cells(self) -> tuple[str, ...]:
        """Generator, label, outline, LiDAR share, free space, colour, total; for tables."""
        score = self.score
        if score is None:
            return self.generator, self.label, "", "", "", "", ""
        shares = [score.outline, score.lidar, score.free]
        return (
            self.generator,
            self.label,
            *("" if share is None else f"{share:.0%}" for share in shares),
            "" if score.colour is None else f"{score.colour:.3f}",
            f"{score.total:.1f}" + ("" if score.fits else ", does not fit"),
        )


class Refinement(Record):
    """What following all images of the log did to an actor.

    Attributes:
        images: number of images that were followed.
        held_back: number of the log's training images that judged.
        left_out: why other images that show the box were not used, and how many.
        loss_before, loss_bent, loss_after: losses on the held-back images: as registered, after the
            body was moved and bent, at the end. None where no image could be held back.
        kept: whether the refined actor was better there; if not, the registered one stayed.
        steps: number of steps of the free stage until it stopped.
        moved: (3,) metres; turned: radians; grew: (3,) factors along, across, up.
        pose_correction: root mean square of the track's corrections at the images, metres.
        shadow: factor of the contact shadow's opacity.
        seen, mirrored: shares of the vehicle's surface (by area of its Gaussians' discs).
        notes: what was not done, and why.
    """

    images: int
    held_back: int = 0
    left_out: dict[str, int]
    loss_before: float | None = None
    loss_bent: float | None = None
    loss_after: float | None = None
    kept: bool = False
    steps: int = 0
    moved: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turned: float = 0.0
    grew: tuple[float, float, float] = (1.0, 1.0, 1.0)
    pose_correction: float = 0.0
    shadow: float = 1.0
    seen: float = 0.0
    mirrored: float = 0.0
    notes: tuple[str, ...] = ()

    def explain(self) -> str:
        """A few lines for people."""
        losses = [self.loss_before, self.loss_bent, self.loss_after]
        judged = " -> ".join(f"{loss:.3f}" for loss in losses if loss is not None)
        lines = list(self.notes)
        if self.steps:
            lines += [
                f"refined by {self.images} images in {self.steps} steps; loss on {self.held_back} "
                f"others {judged} (registered, bent, refined)"
                + ("" if self.kept else ": not better, so the registered actor stays"),
                f"seen {self.seen:.0%}, mirrored {self.mirrored:.0%}, invented "
                f"{max(1 - self.seen - self.mirrored, 0):.0%} of the surface",
            ]
        lines += [f"left out {count}: {reason}" for reason, count in self.left_out.items()]
        return "\n".join(lines)


class Provenance(SourceView):
    """Where an actor comes from: its source image, which is the best view, and more.

    Attributes:
        generator, seed, details: generator, seed and details of the asset.
        sides_seen: sides of the box that faced the camera.
        mask: quality of the mask.
        observation: why that image was taken, in words.
        registration: see `RegistrationReport`.
        further: other views that were used.
        refinement: see `Refinement`; None for an actor that was only registered.
        candidates: the vehicles that it was chosen from.
    """

    generator: str
    seed: int
    details: dict[str, str | float | int]
    sides_seen: tuple[str, ...]
    mask: MaskQuality
    observation: str
    registration: RegistrationReport
    further: tuple[SourceView, ...] = ()
    refinement: Refinement | None = None
    candidates: tuple[CandidateRecord, ...] = ()

    def warnings(self) -> tuple[str, ...]:
        """What a person should look at: the mask, and what the generator doubts."""
        doubts = str(self.details.get("doubts", ""))
        complaints = self.mask.warnings(self.generator == PEOPLE_GENERATOR)
        return (*complaints, *filter(None, doubts.split("; ")))

    @staticmethod
    def of(asset: Asset, observation: Observation, report: RegistrationReport) -> Provenance:
        """Gather the record of an asset that was registered."""
        return Provenance(
            **_source(observation),
            generator=asset.generator,
            seed=asset.seed,
            details=dict(asset.details),
            sides_seen=observation.sides_seen(),
            mask=observation.mask_quality,
            observation=observation.explain(),
            registration=report,
            further=tuple(SourceView(**_source(one)) for one in observation.further),
        )


def _source(observation: Observation) -> dict[str, Any]:
    """The members of a `SourceView`."""
    view = observation.view
    return {
        "camera": view.camera,
        "frame": view.frame,
        "timestamp_us": view.timestamp_us,
        "azimuth": observation.azimuth,
    }


@dataclass(frozen=True, repr=False)
class Actor(Brief):
    """A view-complete vehicle, ready to stand in for a track.

    Attributes:
        track_id, category: id and category of the track.
        size: (3,) logged box, metres; collisions are judged by it.
        gaussians: actor-local frame: box centre, x forward, y left, z up.
        shadow: contact shadow in the same frame.
        provenance: see `Provenance`.
        source: (H, W, 4) uint8 crop it was made from.
        low_pass: the filter that the vehicle's Gaussians were made for.
        shares: shares that tell where each Gaussian comes from; None for an actor that was only
            registered.
        trajectory: the track's poses as corrected with the actor, world frame; None likewise.
        sun: (D,) what its shadow in the log says of the sun, see
            `recast.actors.refine.images.ShadowEvidence`; None likewise.
        seen_shadow: the shadow that the images show, actor frame; it holds for the headings and the
            light of the log. None likewise.
        gait: how a person's limbs move with its way; None for a vehicle.
    """

    track_id: str
    category: str
    size: Array
    gaussians: Gaussians
    shadow: Gaussians
    provenance: Provenance
    source: NDArray[np.uint8]
    low_pass: LowPass
    shares: Shares | None = None
    trajectory: Trajectory | None = None
    sun: Array | None = None
    seen_shadow: Gaussians | None = None
    gait: Gait | None = None

    def _facts(self) -> Mapping[str, object]:
        return {
            "track": self.track_id,
            "category": self.category,
            "size": " x ".join(f"{side:.2f}" for side in self.size) + " m",
            "gaussians": len(self.gaussians),
            "generator": self.provenance.generator,
            "refined": "no" if self.provenance.refinement is None else "yes",
        }

    def at(self, pose: Array) -> Gaussians:
        """Its Gaussians with the limbs that it has at `pose` (4, 4) `world_from_actor`."""
        return self.gaussians if self.gait is None else self.gait.at(self.gaussians, pose)

    def inserted_into(self, scene: StreetScene) -> StreetScene:
        """The scene with this vehicle in its track's place; see `recast.actors.insert`."""
        from recast.actors.insert import insert

        return insert(scene, self)

    def validate(self) -> None:
        """Raise ValueError naming the field at fault."""
        least, most = BOX_SIDE
        if self.size.shape != (3,) or not np.all((self.size >= least) & (self.size <= most)):
            raise ValueError(
                f"Actor.size: expected three lengths of {least} to {most} m, got {self.size}"
            )
        if len(self.gaussians) == 0:
            raise ValueError("Actor.gaussians: expected at least one")
        self.gaussians.validate()
        self.shadow.validate()
        if self.seen_shadow is not None:
            self.seen_shadow.validate()
        fault = None if self.shares is None else self.shares.fault(len(self.gaussians))
        if fault is not None:
            raise ValueError(f"Actor.shares.{fault[0]}: {fault[1]}")
        if self.gait is not None:
            self.gait.validate("Actor.gait", len(self.gaussians))
        if self.trajectory is not None:
            self.trajectory.validate("Actor.trajectory")
        if self.sun is not None and (
            self.sun.shape != (DIRECTIONS,) or not np.isfinite(self.sun).all()
        ):
            raise ValueError(
                f"Actor.sun: expected {DIRECTIONS} finite numbers, got shape {self.sun.shape}"
            )
        if self.source.ndim != 3 or self.source.shape[2] != 4 or self.source.dtype != np.uint8:
            raise ValueError(
                f"Actor.source: expected (H, W, 4) uint8, got {self.source.shape} "
                f"{self.source.dtype}"
            )
