"""All frames that may show a track: their scores, and the best of them, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array
from recast.cameras import PinholeCamera, box_rectangle
from recast.core.errors import InputError
from recast.geometry import boxes, se3
from recast.logs import CameraStream, DrivingLog, LidarSweep, Track
from recast.logs.types import PEOPLE

_BOX_MARGIN = 0.05  # labels are often a little small: a share of the box's extent in the image
_OCCLUDER_GAP = 0.4  # metres before the box from which a LiDAR return counts as in front of it
Usable = Callable[[str, int], bool]
"""Whether a frame may be looked at, by camera name and index; held-out frames may not."""

LEAST_TURN = np.radians(15.0)
"""Angle between the azimuths of two views of one track, at least."""
_FULL_TURN = np.radians(90.0)  # a view turned that much shows another side
_LEAST_SHARE = 0.2  # of the best view's detail: smaller or more hidden ones tell too little
_LEAST_GAIN = 0.1  # of the best view's detail
_LEAST_IN_IMAGE = 1 / 3  # of the box: of less, neither the place nor the mask can be told
_MIN_CHECKED = 4
_WHOLE_IN_IMAGE = 0.95  # the box is grown: the vehicle itself is not cut
_SMALLEST_WHOLE = 24.0  # pixels: of less, a cut vehicle nearby tells more
_CUT_SCORE = 1e-3  # factor on the score of a frame that cuts the vehicle
_SWEEP_REACH_US = 150_000


def score_frame(
    log: DrivingLog, track: Track, stream: CameraStream, frame: int
) -> ViewScore | None:
    """Terms of one frame but for `unblocked`, which stays 1 until `check_lidar`.

    None where the track is not there or not in view.
    """
    time = int(stream.timestamps_us[frame])
    if not track.trajectory.covers(time):
        return None
    camera_from_world = se3.inverse(log.world_from_rig.at(time) @ stream.rig_from_camera)
    camera_from_object = camera_from_world @ track.trajectory.at(time)
    eye = se3.inverse(camera_from_object)[:3, 3]
    if camera_from_object[2, 3] < 0.5 * track.size[0]:  # beside or behind the camera
        return None
    camera = stream.camera.rectified()
    rectangle = box_rectangle(track.size, camera_from_object, camera)
    if rectangle is None:
        return None
    grow = _BOX_MARGIN * (rectangle[2:] - rectangle[:2])
    left, top, right, bottom = np.concatenate([rectangle[:2] - grow, rectangle[2:] + grow])
    width = min(right, camera.width) - max(left, 0.0)
    height = min(bottom, camera.height) - max(top, 0.0)
    if width <= 0 or height <= 0:
        return None
    inside = width * height
    return ViewScore(
        camera=stream.name,
        frame=frame,
        timestamp_us=time,
        size_px=float(np.sqrt(inside)),
        in_image=float(inside / ((right - left) * (bottom - top))),
        unoccluded=_unoccluded(log, track, time, camera_from_world),
        unblocked=1.0,
        azimuth=float(np.arctan2(eye[1], eye[0])),
    )


def _unoccluded(log: DrivingLog, track: Track, time: int, camera_from_world: Array) -> float:
    """Share of points of the track's box whose line of sight misses the other tracks' boxes."""
    targets = boxes.lattice(track.size, track.trajectory.at(time))
    eye = se3.inverse(camera_from_world)[:3, 3]
    hidden = np.zeros(len(targets), bool)
    for other in log.tracks.values():
        if other.track_id != track.track_id and other.trajectory.covers(time):
            hidden |= _crosses_box(eye, targets, other.size, other.trajectory.at(time))
    return float(1 - hidden.mean())


def _crosses_box(
    eye: Array, targets: Array, size: Array, world_from_box: Array
) -> NDArray[np.bool_]:
    """Which segments eye-target (N, 3) meet a box."""
    box_from_world = se3.inverse(world_from_box)
    start = se3.apply(box_from_world, eye[None])[0]
    step = se3.apply(box_from_world, targets) - start
    enter, leave = crossing(start, step, -size / 2, size / 2)
    return (enter < leave) & (leave > 0) & (enter < 1)


def crossing(start: Array, step: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Shares t (N,) at which lines start + t step (N, 3) enter and leave the box low to high (3,).

    They are clipped against the box's three slabs: lines that miss it leave before they enter.
    """
    step = np.where(np.abs(step) < 1e-9, 1e-9, step)
    first, last = (low - start) / step, (high - start) / step
    return np.minimum(first, last).max(axis=1), np.maximum(first, last).min(axis=1)


class NearestSweeps:
    """The LiDAR sweep nearest to a time; remembers the last one, since decoding takes a while."""

    def __init__(self, log: DrivingLog) -> None:
        self._log = log
        self._last: tuple[str, int, LidarSweep] | None = None

    def at(self, time: int) -> LidarSweep | None:
        """The nearest sweep, or None where none lies within 0.15 s."""
        found = [
            (int(gaps.min()), lidar.name, int(gaps.argmin()))
            for lidar in self._log.lidars.values()
            if len(gaps := np.abs(lidar.timestamps_us - time))
        ]
        gap, name, index = min(found, key=lambda one: one[0], default=(_SWEEP_REACH_US + 1, "", 0))
        if gap > _SWEEP_REACH_US:
            return None
        if self._last is None or self._last[:2] != (name, index):
            self._last = (name, index, self._log.lidars[name].sweeps[index])
        return self._last[2]


def check_lidar(
    log: DrivingLog, track: Track, score: ViewScore, sweeps: NearestSweeps
) -> ViewScore:
    """The score with `unblocked` filled in: one minus the share of LiDAR returns inside the box's
    rectangle that are nearer than the box.
    """
    time = score.timestamp_us
    stream = log.cameras[score.camera]
    sweep = sweeps.at(time)
    camera_from_world = se3.inverse(log.world_from_rig.at(time) @ stream.rig_from_camera)
    camera_from_object = camera_from_world @ track.trajectory.at(time)
    rectangle = box_rectangle(track.size, camera_from_object, stream.camera)
    if sweep is None or rectangle is None:
        return score
    world = se3.apply(log.world_from_rig.at(sweep.timestamp_us), sweep.points)
    points = se3.apply(camera_from_world, world)
    points = points[points[:, 2] > 0.5]
    pixels, depth = stream.camera.rectified().project(points)
    pad = 0.15 * (rectangle[2:] - rectangle[:2])
    aimed = np.all((pixels > rectangle[:2] + pad) & (pixels < rectangle[2:] - pad), axis=1)
    box = boxes.corners(track.size, camera_from_object)
    # the near side of the box along each line of sight is at least as far as its nearest corner
    in_front = aimed & (depth < box[:, 2].min() - _OCCLUDER_GAP)
    unblocked = float(1 - in_front.sum() / max(int(aimed.sum()), 1))
    return replace(score, unblocked=unblocked)


class ViewPool:
    """The frames in which a track is in view, with their scores.

    LiDAR occlusion can only lower a score. So it is checked from the top of a list down, until no
    frame left could win.

    Args:
        cameras: consider only these camera streams; all if none is named.
        usable: consider only these frames; all if None.

    Raises:
        InputError: the log has no such camera.
    """

    def __init__(
        self,
        log: DrivingLog,
        track: Track,
        cameras: Sequence[str] = (),
        usable: Usable | None = None,
    ) -> None:
        for camera in cameras:
            if camera not in log.cameras:
                names = ", ".join(log.cameras)
                raise InputError(
                    log.name, f"camera {camera}", "is not in the log", f"choose from {names}"
                )
        self._log, self._track, self._sweeps = log, track, NearestSweeps(log)
        self._checked: dict[tuple[str, int], ViewScore] = {}
        self._bounds = [
            score
            for name, stream in log.cameras.items()
            if not cameras or name in cameras
            for frame in range(len(stream.timestamps_us))
            if (usable is None or usable(name, frame))
            and (score := score_frame(log, track, stream, frame)) is not None
        ]

    def ranked(self) -> list[ViewScore]:
        """The best frames, best first, at least four if there are so many; ties: earlier first.

        A frame whose border cuts the vehicle comes after all that show it whole.
        """
        return self._best(
            lambda view: view.score * (1.0 if view.whole else _CUT_SCORE), _MIN_CHECKED
        )

    def next_best(
        self, taken: Sequence[ViewScore], left_out: Sequence[ViewScore]
    ) -> ViewScore | None:
        """The frame that adds most to those taken: by its detail times the turn to the nearest one.

        The turn counts in full from 90 degrees of azimuth on, and not at all below `LEAST_TURN`.
        None if no frame is left that adds a tenth of what the first view tells.

        Args:
            taken: views so far, best first; at least one.
            left_out: views that turned out to be unusable.
        """
        first = taken[0].detail
        refused = {view.key for view in left_out}

        def gain(view: ViewScore) -> float:
            turn = min(_turn(view, other) for other in taken)
            adds = view.detail * min(turn / _FULL_TURN, 1.0)
            enough = turn >= LEAST_TURN and adds >= _LEAST_GAIN * first
            whole = view.in_image >= _LEAST_IN_IMAGE and view.detail >= _LEAST_SHARE * first
            return adds if enough and whole and view.key not in refused else 0.0

        best = self._best(gain, 1)
        return best[0] if best else None

    def _best(self, value: Callable[[ViewScore], float], count: int) -> list[ViewScore]:
        """The frames checked on the way to the most valuable one, that first."""
        checked: list[tuple[float, ViewScore]] = []
        bounds = [(value(bound), bound) for bound in self._bounds]
        for limit, bound in sorted(bounds, key=lambda one: -one[0]):
            best = max((found for found, _ in checked), default=0.0)
            if limit <= 0 or (len(checked) >= count and best >= limit):
                break
            score = self._check(bound)
            if (found := value(score)) > 0:
                checked.append((found, score))
        return [score for _, score in sorted(checked, key=lambda one: -one[0])]

    def _check(self, bound: ViewScore) -> ViewScore:
        if bound.key not in self._checked:
            self._checked[bound.key] = check_lidar(self._log, self._track, bound, self._sweeps)
        return self._checked[bound.key]


def _turn(first: ViewScore, second: ViewScore) -> float:
    """Angle between the azimuths of two views, radians in [0, pi]."""
    apart = first.azimuth - second.azimuth
    return float(abs(np.arctan2(np.sin(apart), np.cos(apart))))


SIDES = {"front": (0, 1), "rear": (0, -1), "left": (1, 1), "right": (1, -1), "top": (2, 1)}
"""Axis and sign of the way out of a box through each of its sides."""
_COVERAGE = (0.45, 0.97)  # shares of the projected box that the mask of a vehicle fills
_COVERAGE_OF_LIMBS = (0.1, 1.0)
_LIDAR_SHARE = 0.85  # of the LiDAR points, that a good mask puts on the right side


@dataclass(frozen=True)
class ViewScore:
    """How good one frame is as the only view of a track; the terms multiply to `score`.

    Attributes:
        camera: name of the camera stream.
        frame: index of the frame in it.
        timestamp_us: its time.
        size_px: square root of the area of the projected box inside the image, pixels.
        in_image: share of the projected box that lies inside the image.
        unoccluded: share of the box that no other track's box hides.
        unblocked: share of the LiDAR returns towards the box that are not in front of it.
        azimuth: direction to the camera in the object frame, radians: 0 ahead, +pi/2 to its left.
        score: size_px * in_image^3 * unoccluded^2 * unblocked.
    """

    camera: str
    frame: int
    timestamp_us: int
    size_px: float
    in_image: float
    unoccluded: float
    unblocked: float
    azimuth: float

    @property
    def key(self) -> tuple[str, int]:
        """Camera and frame."""
        return self.camera, self.frame

    @property
    def score(self) -> float:
        """Larger is better."""
        return self.size_px * self.in_image**3 * self.unoccluded**2 * self.unblocked

    @property
    def whole(self) -> bool:
        """Whether the image's border does not cut the vehicle, and it is not tiny."""
        return self.in_image >= _WHOLE_IN_IMAGE and self.size_px >= _SMALLEST_WHOLE

    @property
    def detail(self) -> float:
        """How much the frame tells beside others: what lies outside its image, they may show."""
        return self.size_px * self.in_image * self.unoccluded**2 * self.unblocked

    def explain(self) -> str:
        """One line with the score and its terms."""
        return (
            f"{self.camera} frame {self.frame}: score {self.score:.0f} = "
            f"size {self.size_px:.0f} px x in image {self.in_image:.2f}^3 x "
            f"not hidden by other tracks {self.unoccluded:.2f}^2 x "
            f"no LiDAR return in front {self.unblocked:.2f}"
        )


@dataclass(frozen=True)
class MaskQuality:
    """Numbers that tell a good vehicle mask from a bad one.

    Attributes:
        box_coverage: share of the projected 3D box's outline that the mask fills.
        border_contact: share of the crop's border pixels that the mask touches; 0 is best.
        lidar_inside: share of the vehicle's projected LiDAR points that lie in the mask.
        lidar_outside: share of the background's projected LiDAR points that lie outside it.
        notes: how the segmenter made it, in its words.
        doubts: what the segmenter itself would have a person look at.
    """

    box_coverage: float
    border_contact: float
    lidar_inside: float
    lidar_outside: float
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def explain(self) -> str:
        """One line with the shares, then the segmenter's notes, a line each."""
        inside = (
            f"{self.lidar_inside:.0%} of the target's LiDAR points in it"
            if np.isfinite(self.lidar_inside)
            else "no LiDAR points of the target"
        )
        shares = (
            f"mask: fills {self.box_coverage:.0%} of the projected box, touches "
            f"{self.border_contact:.0%} of the crop's border, {inside}, "
            f"{self.lidar_outside:.0%} of the background's outside it"
        )
        return "\n".join([shares, *self.notes])

    @property
    def agrees(self) -> bool:
        """Whether the mask fits the box and the LiDAR; `warnings` says more."""
        shares = self.lidar_inside, self.lidar_outside
        return _COVERAGE[0] <= self.box_coverage <= _COVERAGE[1] and min(shares) >= _LIDAR_SHARE

    def warnings(self, limbs: bool = False) -> tuple[str, ...]:
        """What a person should look at, empty for a mask without complaint.

        Args:
            limbs: whether it is the mask of a pedestrian or cyclist, which fills little of a box.
        """
        found = []
        least, most = _COVERAGE_OF_LIMBS if limbs else _COVERAGE
        if not least <= self.box_coverage <= most:
            found.append(f"mask fills {self.box_coverage:.0%} of the projected box")
        if self.border_contact > 0.02:
            found.append(f"mask touches {self.border_contact:.0%} of the crop's border")
        if self.lidar_inside < _LIDAR_SHARE:
            found.append(
                f"only {self.lidar_inside:.0%} of the target's LiDAR points are in the mask"
            )
        if self.lidar_outside < _LIDAR_SHARE:
            found.append(
                f"only {self.lidar_outside:.0%} of the background's LiDAR points are outside the "
                "mask"
            )
        return (*found, *self.doubts)


@dataclass(frozen=True)
class Observation:
    """One view of a track, cut out and ready for a generator.

    Attributes:
        track_id, category: id and category of the track.
        size: (3,) length, width, height of its box, metres.
        rgba: (H, W, 4) uint8 crop, alpha from the segmenter, nearly square.
        camera: pinhole of the crop, without distortion.
        camera_from_object: (4, 4), object frame: box centre, x forward, y left, z up.
        points: (N, 3) float32 LiDAR points in the box over all sweeps, object frame.
        view: score terms of the frame taken.
        candidates: the best frames, best first.
        mask_quality: see `MaskQuality`.
        further: views of other sides, if they were asked for; of each only what is its own differs.
    """

    track_id: str
    category: str
    size: Array
    rgba: NDArray[np.uint8]
    camera: PinholeCamera
    camera_from_object: Array
    points: NDArray[np.float32]
    view: ViewScore
    candidates: tuple[ViewScore, ...]
    mask_quality: MaskQuality
    further: tuple[Observation, ...] = ()

    @property
    def views(self) -> tuple[Observation, ...]:
        """This view and the further ones."""
        return (self, *self.further)

    @property
    def eye(self) -> Array:
        """(3,) position of the camera in the object frame, metres."""
        rotation, translation = self.camera_from_object[:3, :3], self.camera_from_object[:3, 3]
        return -rotation.T @ translation

    @property
    def azimuth(self) -> float:
        """Direction to the camera in the object frame, radians: 0 ahead, +pi/2 to its left."""
        return float(np.arctan2(self.eye[1], self.eye[0]))

    def sides_seen(self) -> tuple[str, ...]:
        """Sides of the box that face the camera: front, rear, left, right, top."""
        half, eye = self.size / 2, self.eye
        return tuple(name for name, (axis, sign) in SIDES.items() if sign * eye[axis] > half[axis])

    def explain(self) -> str:
        """Why this frame: its score, the runners-up, and what the mask looks like."""
        seen = ", ".join(self.sides_seen()) or "none"
        lines = [
            f"track {self.track_id}: {self.view.explain()}",
            f"seen from azimuth {np.degrees(self.azimuth):.0f} degrees (sides: {seen}), "
            f"distance {np.linalg.norm(self.eye):.1f} m, {len(self.points)} LiDAR points",
        ]
        others = [c for c in self.candidates if c is not self.view][:3]
        lines += [f"next: {c.explain()}" for c in others]
        lines.append(self.mask_quality.explain())
        lines += [
            f"further view: {one.view.explain()}, azimuth {np.degrees(one.azimuth):.0f} degrees"
            for one in self.further
        ]
        complaints = self.mask_quality.warnings(self.category in PEOPLE)
        lines += [f"warning: {text}" for text in complaints]
        return "\n".join(lines)
