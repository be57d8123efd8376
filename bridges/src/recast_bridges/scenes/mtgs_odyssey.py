"""What Odyssey's scenes add to the portable layout of MTGS: sheets of ground, a sky, and the ego.

Source: the published renderer of Odyssey's scenes, whose equations are those of DriveStudio.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array, Int64Array
from recast.logs.checks import LATEST_US, WORLD_REACH
from recast.splats.gaussians import quat_multiply
from recast_bridges.scenes.checkpoint import CheckpointTable, Names, read_faces

GROUND = "OmniReGroundSubModel"
CHECKPOINT = "scene.ckpt"
"""Name of the checkpoint in the scene's folder."""
FAR_M = 10_000.0
"""No reconstruction is as large: ground whose centre is farther away has lost its frame."""
_SKY, _CALIBRATION = "omnire_environment", "omnire_calibration"


def ground_members(
    config: CheckpointTable, state: CheckpointTable, table: CheckpointTable, names: Names
) -> dict[str, Tensor]:
    """Sheets of ground as Gaussians: means, log scales and quaternions by the layout's names.

    A sheet turns about z alone, or about the normal of the surface (`surface_follow`). Its extents
    are clamped, and its thickness is that of all sheets.

    Args:
        config, state, table: settings, state and Gaussians of the node.

    Raises:
        InputError: a member is missing, of another shape, not finite, or out of range.
    """
    means = table.tensor(names.means, None, 3, dtype=torch.float64)
    count = len(means)
    least, most = (config.number(f"{which}_planar_extent") for which in ("min", "max"))
    thickness = config.number("thickness")
    if not 0 < least < most < FAR_M:
        raise config.fault("min_planar_extent", f"and max_planar_extent are {least:g}, {most:g}")
    if not 0 < thickness < FAR_M:
        raise config.fault("thickness", f"is {thickness:g} m")
    planar = table.tensor(names.log_scales, count, 3)[:, :2].clamp(math.log(least), math.log(most))
    turns = table.tensor(names.quats, count, 4) * torch.tensor([1.0, 0, 0, 1])
    norms = turns.norm(dim=1, keepdim=True)
    if bool((norms < 1e-6).any()):
        raise table.fault(names.quats, "holds a quaternion without a turn about z")
    turns = turns / norms
    if bool(config.raw("surface_follow")):
        turns = quat_multiply(state.tensor("surface_quats", count, 4), turns)
    elif "surface_quats" in state:
        raise state.fault("surface_quats", "is there, but config.surface_follow is not set")
    thin = torch.full((count, 1), math.log(thickness))
    return {
        names.means: means if not lost(means) else _found_again(means, config),
        names.log_scales: torch.cat([planar, thin], dim=1),
        names.quats: turns,
    }


def lost(means: Tensor) -> bool:
    """Whether ground lies where no reconstruction does.

    Its exporter takes `recon2world_translation` off the ground alone.
    """
    return len(means) > 0 and float(means.double().mean(dim=0).norm()) > FAR_M


def _found_again(means: Tensor, config: CheckpointTable) -> Tensor:
    shift = read_shift(config)
    found = means + torch.from_numpy(shift)
    if lost(found):
        raise config.fault("recon2world_translation", "does not bring the ground near the scene")
    return found


def read_shift(config: CheckpointTable) -> Array:
    """Metres (3,) from the scene's origin to that of its map frame.

    Raises:
        InputError: it is missing, or something else.
    """
    shift = config.array("recon2world_translation").reshape(-1)
    if shift.shape != (3,) or not np.all(np.abs(shift) <= WORLD_REACH):  # also NaN
        raise config.fault("recon2world_translation", "is not three metres")
    return shift


def read_environment(config: CheckpointTable) -> Tensor | None:
    """The cubemap (6, R, R, 3) of the sky in the background's settings; None if they have none.

    It is looked up as DriveStudio's, by `CUBE_FROM_SCENE`.

    Raises:
        InputError: it is no cubemap.
    """
    return read_faces(config, _SKY) if _SKY in config else None


def exposed(config: CheckpointTable) -> bool:
    """Whether the background's settings have exposures of single images, which are not read."""
    return _CALIBRATION in config and config.table(_CALIBRATION).raw("exposure") is not None


def read_ego(config: CheckpointTable) -> tuple[Int64Array, Array] | None:
    """Times (F,) in microseconds and places (F, 3) of the ego in the scene; None if not saved.

    Raises:
        InputError: they are of another shape, or out of range.
    """
    if _CALIBRATION not in config or config.table(_CALIBRATION).raw("ego_to_global") is None:
        return None
    saved = config.table(_CALIBRATION)
    times = saved.array("training_timestamps_us").reshape(-1)
    poses = saved.array("ego_to_global")
    if poses.shape != (len(times), 4, 4) or not np.all(np.abs(poses[:, :3, 3]) <= 2 * WORLD_REACH):
        problem = f"has shape {list(poses.shape)}, expected [{len(times)}, 4, 4] in metres"
        raise saved.fault("ego_to_global", problem)
    if not np.all((times >= 0) & (times < LATEST_US)):
        raise saved.fault("training_timestamps_us", "are not microseconds")
    return times.round().astype(np.int64), poses[:, :3, 3] - read_shift(config)
