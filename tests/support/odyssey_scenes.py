"""A scene as Odyssey publishes it: ground sheets, a skybox and the ego's places."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from recast.splats import Gaussians
from support import trained_scenes as made
from support.mtgs_scenes import RECON_FROM_OFFSET, SCENE_FROM_WORLD, checkpoint, in_scene, part

SHEETS = 60
LEAST, MOST, THICKNESS = 0.1, 0.4, 0.02
ANCHOR = made.OFFSET + RECON_FROM_OFFSET + np.array([600_000.0, 4_000_000.0, 0.0])
"""As far from the origin of the map as nuPlan's cities are."""


def sheets() -> Gaussians:
    """Stored ground: what the third scale and x, y of the quaternion say is not drawn."""
    found = made.make_gaussians(SHEETS, np.array([9.0, 1, 0]), np.array([8.0, 6, 0.1]), 1, 17)
    return in_scene(found)


def surface() -> np.ndarray:
    """(N, 4) wxyz of tilts up to 0.4 rad about level axes."""
    axes = np.random.default_rng(3).normal(size=(SHEETS, 3)) * [0.2, 0.2, 0.0]
    return Rotation.from_rotvec(axes.clip(-0.4, 0.4)).as_quat(scalar_first=True)


def ground(follow: bool = True, **config: Any) -> dict[str, Any]:
    extents = {"min_planar_extent": LEAST, "max_planar_extent": MOST, "thickness": THICKNESS}
    anchor = {"recon2world_translation": ANCHOR}
    own = part("OmniReGroundSubModel", sheets(), surface_follow=follow, **extents, **anchor)
    own["config"].update(config)
    if follow:
        own["state_dict"]["surface_quats"] = torch.from_numpy(surface()).float()
    return own


def calibration(later_us: int = 0, aside: float = 0.0) -> dict[str, Any]:
    poses = np.stack([SCENE_FROM_WORLD @ made.world_from_rig(i) for i in range(made.FRAMES)])
    poses[:, :3, 3] += ANCHOR + np.array([0, aside, 0])
    return {
        "training_timestamps_us": torch.from_numpy(made.TIMES + later_us),
        "ego_to_global": torch.from_numpy(poses),
        "exposure": {"gain": torch.ones(3)},
        "rasterize_mode": "classic",
    }


def odyssey(**changes: Any) -> dict[str, Any]:
    content = checkpoint(ground=ground(), skybox=None, **changes)
    config = content["background"]["config"]
    config["recon2world_translation"] = ANCHOR
    config["omnire_calibration"] = calibration()
    lights = part("OmniReTrafficLightSubModel", made.make_car(0, 5))
    return {**content, "na_lights": lights}
