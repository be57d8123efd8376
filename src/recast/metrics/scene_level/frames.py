"""Which images of a rollout, and which logged images, the scene-level evaluation looks at.

The rule looks at boxes and at what hides them in any of the streets, never at what an arm draws in
the box, so that all arms are judged on the same images. The paper says neither how many images it
takes nor which; the numbers here are settings of ours. Files keep the images that count.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt

from recast.actors.observation import score_frame
from recast.arrays import Array
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.records import Record, read_record
from recast.geometry import boxes, se3
from recast.logs import DrivingLog
from recast.metrics.oracle_scores import box_pixels
from recast.reconstruction.scores import Rectangle

FRAMES_FILE, REFERENCES_FILE = "frames.json", "references.json"
_VERSION: Literal[1] = 1
_MEND = "remove the artefact that holds it, and run again"


@dataclass(frozen=True)
class FrameRule:
    """When an image counts.

    Attributes:
        every: steps between the images of a rollout.
        least_px: least length in pixels of the shorter side of the box's rectangle, at least half
            of which is in the image.
        nearest, furthest: metres from the camera to the centre of the box.
        least_visible: share of points of the box that nothing may hide.
    """

    every: int = 5
    least_px: float = 32.0
    nearest: float = 3.0
    furthest: float = 60.0
    least_visible: float = 0.5

    def validate(self) -> None:
        """Raise InputError naming the option at fault."""
        checks = (
            ("`every`", self.every >= 1, self.every, "1 or more"),
            ("`least_px`", self.least_px >= 4, self.least_px, "4 or more"),
        )
        for option, fits, value, range_of in checks:
            if not fits:
                raise InputError(option, "value", f"is {value}", f"give {range_of}")

    def rectangle(
        self, size: Array, camera_from_actor: Array, camera: PinholeCamera
    ) -> Rectangle | None:
        """The box's rectangle in whole pixels, clipped to the image; None if it does not count.

        Args:
            size: (3,) lengths of the logged box's sides, metres.
            camera_from_actor: (4, 4).
            camera: intrinsics of the image as it is rendered.
        """
        if not self.nearest <= np.linalg.norm(camera_from_actor[:3, 3]) <= self.furthest:
            return None
        found = box_pixels(size, camera_from_actor, camera)
        if found is None or min(found[2] - found[0], found[3] - found[1]) < self.least_px:
            return None
        return found


@dataclass(frozen=True)
class RolloutFrame:
    """An image of a rollout that counts.

    Attributes:
        motion, setting, step: motion and setting of the rollout, and the step in it.
        rectangle: left, top, right, bottom of the logged box at the simulated pose, pixels.
    """

    motion: str
    setting: str
    step: int
    camera: str
    rectangle: Rectangle


@dataclass(frozen=True)
class LoggedFrame:
    """A logged image that counts.

    Attributes:
        frame: number of the image in its stream.
        timestamp_us: log time.
        rectangle: left, top, right, bottom of the logged box at its logged pose, pixels.
        azimuth: radians, of the camera seen from the vehicle; 0 is ahead of it.
    """

    camera: str
    frame: int
    timestamp_us: int
    rectangle: Rectangle
    azimuth: float


def visible_share(
    depth: NDArray[np.float32], size: Array, camera_from_actor: Array, camera: PinholeCamera
) -> float:
    """Share of 5 x 5 x 5 points of a box that lie in the image and before what is drawn there.

    Args:
        depth: (H, W) metres along the camera's z axis of the street without the vehicle, inf for
            the sky.
        size: (3,) lengths of the box's sides, metres.
        camera_from_actor: (4, 4).
    """
    points = boxes.lattice(size, camera_from_actor)
    ahead = points[points[:, 2] > 0.1]
    pixels, z = camera.project(ahead)
    column, row = np.floor(pixels).astype(np.int64).T
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    before = z[inside] < depth[row[inside], column[inside]]
    return float(before.sum() / len(points))


def logged_frames(
    log: DrivingLog, track_id: str, cameras: Iterable[tuple[str, PinholeCamera]], rule: FrameRule
) -> Iterator[LoggedFrame]:
    """Logged images in which a vehicle's box counts and no other labelled box hides it.

    Args:
        cameras: names with intrinsics as images are rendered.
    """
    track = log.tracks[track_id]
    for name, camera in cameras:
        stream = log.cameras[name]
        for frame in range(len(stream.timestamps_us)):
            score = score_frame(log, track, stream, frame)
            if score is None or score.unoccluded < rule.least_visible:
                continue
            time = score.timestamp_us
            world_from_camera = log.world_from_rig.at(time) @ stream.rig_from_camera
            camera_from_actor = se3.inverse(world_from_camera) @ track.trajectory.at(time)
            rectangle = rule.rectangle(track.size, camera_from_actor, camera)
            if rectangle is not None:
                yield LoggedFrame(name, frame, time, rectangle, score.azimuth)


def spread_over_azimuth(frames: list[LoggedFrame], most: int) -> list[int]:
    """Indices of at most `most` frames whose views of the vehicle differ most, in order.

    Greedy: the first frame, then always the one whose azimuth is furthest from those chosen.
    """
    if len(frames) <= most:
        return list(range(len(frames)))
    angles = np.array([frame.azimuth for frame in frames])
    chosen = [0]
    apart = np.full(len(frames), np.inf)
    while len(chosen) < most:
        turn = np.abs((angles - angles[chosen[-1]] + np.pi) % (2 * np.pi) - np.pi)
        apart = np.minimum(apart, turn)
        apart[chosen] = -1.0
        chosen.append(int(np.argmax(apart)))
    return sorted(chosen)


class FramesRecord(Record):
    """frames.json.

    Attributes:
        frames: frames in the order of motions, steps and cameras.
        shown: indices of the frames that stand in the figure.
        failures: reason why a motion was not driven, by motion with its setting.
    """

    version: Literal[1] = _VERSION
    frames: tuple[RolloutFrame, ...]
    shown: tuple[NonNegativeInt, ...]
    failures: dict[str, str] = Field(default_factory=dict)


class ReferencesRecord(Record):
    """references.json.

    Attributes:
        frames: logged images that count.
        compared: indices of those whose crops LPIPS and the CLIP image score compare with.
    """

    version: Literal[1] = _VERSION
    frames: tuple[LoggedFrame, ...]
    compared: tuple[NonNegativeInt, ...]


def read_frames(folder: Path) -> FramesRecord:
    """Read frames.json; InputError if it is missing or damaged."""
    return read_record(folder / FRAMES_FILE, FramesRecord, _VERSION, _MEND)


def read_references(folder: Path) -> ReferencesRecord:
    """Read references.json; InputError if it is missing or damaged."""
    return read_record(folder / REFERENCES_FILE, ReferencesRecord, _VERSION, _MEND)


def shown_frames(frames: tuple[RolloutFrame, ...]) -> tuple[int, ...]:
    """For each motion and setting, the frame with the largest rectangle, the first of equals."""
    best: dict[tuple[str, str], int] = {}
    for index, frame in enumerate(frames):
        key = (frame.motion, frame.setting)
        if key not in best or _area(frame.rectangle) > _area(frames[best[key]].rectangle):
            best[key] = index
    return tuple(sorted(best.values()))


def _area(rectangle: Rectangle) -> int:
    left, top, right, bottom = rectangle
    return (right - left) * (bottom - top)
