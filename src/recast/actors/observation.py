"""What was seen of a track: the best crop, where its camera stood, and why it was chosen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array
from recast.cameras import PinholeCamera

SIDES = {"front": (0, 1), "rear": (0, -1), "left": (1, 1), "right": (1, -1), "top": (2, 1)}
"""Axis and sign of the way out of a box through each of its sides."""
_COVERAGE = (0.45, 0.97)  # shares of the projected box that the mask of a vehicle fills
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
            f"{self.lidar_inside:.0%} of the vehicle's LiDAR points in it"
            if np.isfinite(self.lidar_inside)
            else "no LiDAR points of the vehicle"
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

    def warnings(self) -> tuple[str, ...]:
        """What a person should look at, empty for a mask without complaint."""
        found = []
        if not _COVERAGE[0] <= self.box_coverage <= _COVERAGE[1]:
            found.append(f"mask fills {self.box_coverage:.0%} of the projected box")
        if self.border_contact > 0.02:
            found.append(f"mask touches {self.border_contact:.0%} of the crop's border")
        if self.lidar_inside < _LIDAR_SHARE:
            found.append(
                f"only {self.lidar_inside:.0%} of the vehicle's LiDAR points are in the mask"
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
        lines += [f"warning: {text}" for text in self.mask_quality.warnings()]
        return "\n".join(lines)
