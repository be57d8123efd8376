"""What the viewer shows: scenes, how everything moves in them, and pictures taken on the way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recast.actors import Actor
from recast.arrays import Array, Image
from recast.core.progress import Progress
from recast.logs import DrivingLog, HdMap
from recast.scene import StreetScene
from recast.simulation import ScriptedMotion


class CameraImages(Protocol):
    """Pictures of one camera, by step of a drive."""

    def __len__(self) -> int:
        """Number of steps that have a picture."""

    def __getitem__(self, step: int, /) -> Image:
        """The picture (H, W, 3) RGB of a step."""


@dataclass(frozen=True)
class MountedCamera:
    """A camera on the rig.

    Attributes:
        rig_from_camera: (4, 4) OpenCV camera frame to rig.
        fov: vertical field of view, radians.
        aspect: width over height.
        film: its pictures; None if there are none.
    """

    rig_from_camera: Array
    fov: float
    aspect: float
    film: CameraImages | None = None


@dataclass(frozen=True)
class ViewerEvent:
    """A moment worth going to: what happened, and at which step."""

    label: str
    step: int


@dataclass(frozen=True)
class ViewedDrive:
    """How the ego and all others move, in T steps.

    Attributes:
        dt: seconds between steps.
        times_us: (T,) int64 log time of each step.
        rig: (T, 4, 4) `world_from_rig`; None if there is no ego.
        poses: `world_from_actor` (T, 4, 4) by track id; NaN where the track is absent.
        sizes: (3,) length, width, height by track id, metres.
        controlled: ids of the tracks that a motion controls, the target first.
        ego_size: (3,) size of the ego's box, metres.
        ego_offset: metres from the rig's origin forward to the centre of the ego's box.
        logged: (T, 3) where the ego was in the log; None if that is `rig`.
        plans: (step, waypoints (P, 3) in the world) of each plan, in order.
        events: moments to go to, in order.
        cameras: cameras by name.
    """

    dt: float
    times_us: NDArray[np.int64]
    rig: Array | None
    poses: Mapping[str, Array]
    sizes: Mapping[str, Array]
    controlled: tuple[str, ...] = ()
    ego_size: Array = field(default_factory=lambda: np.array([4.6, 1.9, 1.6]))
    ego_offset: float = 1.4
    logged: Array | None = None
    plans: tuple[tuple[int, Array], ...] = ()
    events: tuple[ViewerEvent, ...] = ()
    cameras: Mapping[str, MountedCamera] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.times_us)

    def at(self, step: int) -> dict[str, Array]:
        """Poses (4, 4) of the tracks that are present at a step."""
        present = ((key, poses[step]) for key, poses in self.poses.items())
        return {key: pose for key, pose in present if not np.isnan(pose[0, 0])}


@dataclass(frozen=True)
class Runner:
    """Runs rollouts for the page.

    Attributes:
        hdmap: lanes, drivable area and ground.
        track: the actor to control.
        motions: motions to choose from, by name.
        planners: names of the planners to choose from; the first is the default.
        steps: largest number of steps of 0.1 s.
        run: function that runs a motion with a planner in an arm, and gives the drive; reports its
            steps.
    """

    log: DrivingLog
    hdmap: HdMap
    track: str
    motions: Mapping[str, ScriptedMotion]
    planners: tuple[str, ...]
    steps: int
    run: Callable[[ScriptedMotion, str, str, Progress], ViewedDrive]


@dataclass(frozen=True)
class ViewInputs:
    """Everything that the viewer shows.

    Attributes:
        title: title of the page.
        scenes: the street of each arm with its actors in it; None for an arm without Gaussians.
        scenarios: drives by scenario and arm.
        log: the recorded drive, for images, LiDAR and evidence; None if there is none.
        hdmap: lanes and drivable area, or None.
        actors: generated vehicles by arm and track id, for their coverage.
        runner: runs rollouts from the page, or None.
    """

    title: str
    scenes: Mapping[str, StreetScene | None]
    scenarios: Mapping[str, Mapping[str, ViewedDrive]]
    log: DrivingLog | None = None
    hdmap: HdMap | None = None
    actors: Mapping[str, Mapping[str, Actor]] = field(default_factory=dict)
    runner: Runner | None = None

    @property
    def drives(self) -> list[ViewedDrive]:
        """All drives, scenario by scenario."""
        return [drive for arms in self.scenarios.values() for drive in arms.values()]
