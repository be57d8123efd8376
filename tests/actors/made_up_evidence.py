"""Evidence of a vehicle whose looks are known: pictures of it from a ring of cameras."""

from __future__ import annotations

import numpy as np
import torch

from recast.actors.evidence import Evidence, FreeSpace, Sighting
from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.logs import Trajectory
from recast.scene import SceneActor, SkyMap, StreetScene
from recast.scene.actor import draw, look_at
from recast.splats import Gaussians
from support import made_up_actors as made_up

CAMERA = PinholeCamera(72, 48, 75.0, 75.0, 36.0, 24.0)
GREY = 0.4
STEP_US = 100_000


def sightings(
    vehicle: Gaussians, azimuths: np.ndarray, distance: float = 7.0
) -> tuple[Sighting, ...]:
    """Pictures of a vehicle in its box's frame, before a grey sky, from all these azimuths."""
    found = []
    for number, azimuth in enumerate(azimuths):
        eye = distance * np.array([np.cos(azimuth), np.sin(azimuth), 0.25])
        pose = look_at(eye, np.zeros(3))
        with torch.no_grad():
            picture = draw(vehicle, pose, CAMERA, background=(GREY,) * 3)
        found.append(
            Sighting(
                camera_name="front",
                frame=number,
                timestamp_us=number * STEP_US,
                camera=CAMERA,
                camera_from_world=pose,
                world_from_object=np.eye(4),
                image=(picture.rgb.numpy().clip(0, 1) * 255).round().astype(np.uint8),
                mask=(picture.alpha.numpy() > 0.5).astype(np.float32),
                trust=np.ones((CAMERA.height, CAMERA.width), np.float32),
                weight=1.0,
            )
        )
    return tuple(found)


def evidence(vehicle: Gaussians, azimuths: np.ndarray, track_id: str = "7") -> Evidence:
    """Pictures from these azimuths, no LiDAR."""
    nothing = np.zeros((0, 3), np.float32)
    return Evidence(
        track_id, "car", made_up.SIZE, sightings(vehicle, azimuths), nothing, FreeSpace(nothing)
    )


def empty_street(vehicle: Gaussians, count: int) -> StreetScene:
    """A grey sky, one Gaussian underground, and a model of the track that stands at the origin."""
    still = np.tile(np.eye(4), (count, 1, 1))
    track = Trajectory(np.arange(count, dtype=np.int64) * STEP_US, still)
    under = vehicle.select(torch.arange(1)).transformed(
        torch.from_numpy(se3.from_rotation_translation(np.eye(3), [0.0, 0.0, -50.0]))
    )
    own = SceneActor("7", vehicle, made_up.SIZE, track)
    return StreetScene(under, {"7": own}, SkyMap.constant(torch.full((3,), GREY)))
