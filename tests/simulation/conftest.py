"""A street of one ball a track, which needs no training."""

from __future__ import annotations

import pytest
import torch

from recast.scene.actor import SceneActor
from recast.scene.sky import SkyMap
from recast.scene.street_scene import StreetScene
from support.camera_drives import ball, log_with_camera


@pytest.fixture
def scene() -> StreetScene:
    log = log_with_camera()
    actors = {
        key: SceneActor(key, ball(colour, (0.0, 0.0, 0.0)), track.size, track.trajectory)
        for (key, track), colour in zip(log.tracks.items(), [(1, 0, 0), (0, 1, 0)], strict=True)
    }
    sky = SkyMap.constant(torch.zeros(3))
    return StreetScene(ball((0.0, 0.0, 1.0), (30.0, 0.0, -30.0)), actors, sky)
