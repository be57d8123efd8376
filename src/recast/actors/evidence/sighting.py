"""What is known of one vehicle: single images of it, and all of them together with the LiDAR."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recast.actors.evidence.free_space import FreeSpace
from recast.geometry import PinholeCamera
from recast.scene import StreetScene
from recast.scene.dynamic import pose_at

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]


@dataclass(frozen=True)
class Sighting:
    """One image of a log that shows the vehicle, cut to the vehicle and its surroundings.

    Attributes:
        camera_name, frame, timestamp_us: of the image.
        camera: pinhole of the crop, without distortion.
        camera_from_world: (4, 4), with the correction that a scene has learned, if there is one.
        world_from_object: (4, 4); object frame: box centre, x forward, y left, z up.
        image: (H, W, 3) uint8 RGB.
        mask: (H, W) float32 in [0, 1], 1 on the vehicle.
        trust: (H, W) float32 in [0, 1]: how far `mask` is believed; 0 where something hides the
            vehicle or the image is not usable.
        weight: in [0, 1], what the image counts beside the others: size, sharpness, occlusion.
    """

    camera_name: str
    frame: int
    timestamp_us: int
    camera: PinholeCamera
    camera_from_world: Array
    world_from_object: Array
    image: NDArray[np.uint8]
    mask: Float32Array
    trust: Float32Array
    weight: float

    @property
    def camera_from_object(self) -> Array:
        """(4, 4)."""
        return self.camera_from_world @ self.world_from_object

    @property
    def eye(self) -> Array:
        """(3,) position of the camera in the object frame, metres."""
        pose = self.camera_from_object
        eye: Array = -pose[:3, :3].T @ pose[:3, 3]
        return eye


@dataclass(frozen=True)
class Evidence:
    """All that a log knows of a vehicle; held-out images are not in it.

    Attributes:
        track_id, category: of the track.
        size: (3,) length, width, height of the logged box, metres.
        sightings: in order of time.
        hits: (N, 3) float32 LiDAR points on the vehicle, object frame.
        free: where LiDAR rays passed through the box.
        left_out: why images that show the box are not among the sightings, one entry an image.
    """

    track_id: str
    category: str
    size: Array
    sightings: tuple[Sighting, ...]
    hits: Float32Array
    free: FreeSpace
    left_out: tuple[str, ...] = ()

    def posed_by(self, scene: StreetScene) -> Evidence:
        """The evidence with the poses of cameras and track that a scene has learned.

        The scene must have a model of the track.
        """
        trajectory = scene.actors[self.track_id].trajectory
        sightings = []
        for sighting in self.sightings:
            time = sighting.timestamp_us
            pose = pose_at(trajectory, time)
            camera = scene.corrected_camera(sighting.camera_from_world, sighting.camera_name, time)
            if pose is not None:
                sightings.append(
                    replace(sighting, camera_from_world=camera, world_from_object=pose)
                )
        return replace(self, sightings=tuple(sightings))

    def explain(self) -> str:
        """A few lines for people."""
        cameras = Counter(sighting.camera_name for sighting in self.sightings)
        lines = [
            f"track {self.track_id}: {len(self.sightings)} images"
            + "".join(f", {count} of {name}" for name, count in cameras.items()),
            f"{len(self.hits)} LiDAR points, {len(self.free.centres)} cells of the box seen empty",
        ]
        lines += [f"left out {count}: {reason}" for reason, count in Counter(self.left_out).items()]
        return "\n".join(lines)
