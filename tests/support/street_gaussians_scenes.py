"""A trained scene as Street Gaussians saves it."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from recast.geometry import se3
from support import trained_scenes as made

SCENE_ORIGIN = np.mean([made.world_from_rig(f)[:3, 3] for f in range(made.FRAMES)], axis=0)
WORLD_FROM_SCENE = se3.from_rotation_translation(np.eye(3), SCENE_ORIGIN)
ROWS = [(frame, track) for frame in range(made.FRAMES) for track in (5, 6, 8, 3)]
FOURIER = 5


def fourier() -> torch.Tensor:
    generator = torch.Generator().manual_seed(7)
    return 0.15 * torch.randn(80, FOURIER, 3, generator=generator)


def checkpoint(**changes: Any) -> dict[str, Any]:
    background = made.moved(made.make_background(1), se3.inverse(WORLD_FROM_SCENE), True)
    content = {
        "iter": 30000,
        "background": made.street_gaussians_part(background),
        "obj_003": made.street_gaussians_part(made.make_car(1), fourier()),
        "actor_pose": {
            "params": {
                "opt_trans": torch.zeros(made.FRAMES, 1, 3),
                "opt_rots": torch.zeros(made.FRAMES, 1, 1),
            }
        },
        "sky_cubemap": {"params": {"sky_cube_map": torch.nn.Parameter(made.make_cubemap())}},
    }
    return {k: v for k, v in (content | changes).items() if v is not None}
