"""NAVSIM's camera names on the cameras of any rig, by the direction they look in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from recast.errors import InputError
from recast.geometry import se2
from recast.planning.types import CameraMount

NAVSIM_CAMERAS: Mapping[str, float] = {
    "cam_f0": 0.0,
    "cam_l0": 55.0,
    "cam_l1": 110.0,
    "cam_l2": 145.0,
    "cam_r0": -55.0,
    "cam_r1": -110.0,
    "cam_r2": -145.0,
    "cam_b0": 180.0,
}
"""By name the direction in which nuPlan's camera looks, rounded: degrees to the left of ahead."""

NUPLAN_RIG: Mapping[str, str] = {
    "cam_l0": "nuplan_l0",
    "cam_f0": "nuplan_f0",
    "cam_r0": "nuplan_r0",
}
"""For `NavsimPlanner(cameras=...)`: nuPlan's own cameras, rendered for agents that need them."""

WITHIN_DEGREES = 30.0
"""A camera that looks further off than this does not stand for a NAVSIM camera."""


def match_cameras(
    wanted: Sequence[str], mounts: Mapping[str, CameraMount], where: str
) -> dict[str, str]:
    """NAVSIM name to the rig's camera; the closest pairs are made first, each camera used once.

    Args:
        wanted: NAVSIM names.
        mounts: the rig.
        where: who asks, for messages.

    Raises:
        InputError: no camera looks where a wanted one should.
    """
    looks = {name: _yaw_degrees(mount) for name, mount in mounts.items()}
    pairs = sorted(
        (_angle(NAVSIM_CAMERAS[navsim], yaw), i, j, navsim, name)
        for i, navsim in enumerate(wanted)
        for j, (name, yaw) in enumerate(looks.items())
    )
    found: dict[str, str] = {}
    for angle, _, _, navsim, name in pairs:
        if angle <= WITHIN_DEGREES and navsim not in found and name not in found.values():
            found[navsim] = name
    for navsim in wanted:
        if navsim not in found:
            there = ", ".join(f"{name} ({yaw:.0f})" for name, yaw in looks.items())
            raise InputError(
                where, f"camera {navsim}",
                f"is wanted, and no free camera looks within {WITHIN_DEGREES:g} degrees of "
                f"{NAVSIM_CAMERAS[navsim]:.0f} (to the left of ahead)",
                f"there are {there or 'none'}; use a log that has it, or name the cameras yourself",
            )  # fmt: skip
    return {navsim: found[navsim] for navsim in wanted}


def _yaw_degrees(mount: CameraMount) -> float:
    x, y = mount.rig_from_camera[:2, 2]
    return float(np.rad2deg(np.arctan2(y, x)))


def _angle(a: float, b: float) -> float:
    return abs(float(np.rad2deg(se2.wrap_angle(np.deg2rad(a - b)))))
