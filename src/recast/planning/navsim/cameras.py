"""NAVSIM's cameras: where they look, and which of any rig stand for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from recast.errors import InputError
from recast.planning.matching import WITHIN_DEGREES, Look, directions, match_cameras
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

_FIELD = 63.7
"""Horizontal field of view of nuPlan's cameras, degrees, between the edges of a pinhole image."""


def rig_cameras(
    wanted: Sequence[str], mounts: Mapping[str, CameraMount], where: str
) -> dict[str, str]:
    """NAVSIM name to the rig's camera, see `match_cameras`.

    Args:
        wanted: NAVSIM names.
        mounts: the rig.
        where: who asks, for messages.

    Raises:
        InputError: no camera looks where a wanted one should.
    """
    found = match_cameras(
        {name: Look.level(NAVSIM_CAMERAS[name], _FIELD) for name in wanted}, mounts
    )
    for name in wanted:
        if name not in found:
            raise InputError(
                where, f"camera {name}",
                f"is wanted, and no free camera looks within {WITHIN_DEGREES:g} degrees of "
                f"{NAVSIM_CAMERAS[name]:.0f} (to the left of ahead)",
                f"there are {directions(mounts)}; use a log that has it, or name the cameras "
                "yourself",
            )  # fmt: skip
    return found
