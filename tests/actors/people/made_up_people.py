"""People of known build and gait, seen by cameras beside their way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from recast.actors.people.body import PersonShape, Region, surface_of
from recast.actors.people.views import (
    NOWHERE,
    PersonView,
    box_from_body,
    gait_of,
    gaussians_of,
)
from recast.cameras import PinholeCamera
from recast.scene.actor import look_at
from recast.scene.deformation import Gait
from recast.splats import Gaussians

CAMERA = PinholeCamera(72, 96, 247.5, 247.5, 36.0, 48.0)
WALKER = PersonShape(1.72, girth=1.1, cycle=1.25)
BOX = np.array([1.1, 0.6, 1.71])
RIDER = PersonShape(1.72, bicycle=1.75, top=1.68, cycle=5.0)
RIDER_BOX = np.array([1.75, 0.7, 1.68])
COLOURS = np.full((len(Region), 3), 0.3)
COLOURS[Region.SKIN] = 0.8, 0.6, 0.5
COLOURS[Region.TOP] = 0.7, 0.1, 0.1
COLOURS[Region.TROUSERS] = 0.1, 0.15, 0.5
COLOURS[Region.PACK] = 0.9, 0.8, 0.1
BEHIND = 0.62
PHASE = 0.3


def body(shape: PersonShape, size: np.ndarray) -> tuple[Gaussians, Gait]:
    """A coarse body in its box, and its gait."""
    surface, pose = surface_of(shape, 0.03), box_from_body(size, np.zeros(2))
    gaussians = gaussians_of(surface, pose, COLOURS[surface.region])
    return gaussians, gait_of(surface, pose, shape.cycle, PHASE, NOWHERE)


def views(shape: PersonShape, size: np.ndarray, count: int = 7) -> list[PersonView]:
    """Images before a plain wall over four metres of way, from its right and left."""
    gaussians, gait = body(shape, size)
    found = []
    for number in range(count):
        turn = np.radians(-100 + 200 * number / count)
        pose = look_at(6.0 * np.array([np.cos(turn), np.sin(turn), 0.1]), np.zeros(3))
        gone = 4.0 * number / count
        wall = torch.full((CAMERA.height, CAMERA.width, 3), BEHIND)
        nothing = np.zeros((CAMERA.height, CAMERA.width), np.float32)
        empty = PersonView(
            camera=CAMERA,
            camera_from_object=pose,
            image=wall,
            back=wall,
            front=torch.zeros_like(wall),
            through=torch.ones(wall.shape[:2]),
            mask=nothing,
            apart=np.ones_like(nothing),
            trust=np.ones_like(nothing),
            weight=1.0,
            gone=gone,
        )
        with torch.no_grad():
            picture, alpha = empty.drawn(gait.posed(gaussians, PHASE + gone / shape.cycle))
        mask = (alpha.numpy() > 0.5).astype(np.float32)
        found.append(replace(empty, image=picture, mask=mask))
    return found
