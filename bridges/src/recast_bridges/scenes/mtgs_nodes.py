"""What Odyssey's scenes add to the portable layout of MTGS: sheets of ground, a sky, and the ego.

Source: the published renderer of Odyssey's scenes, whose equations are those of DriveStudio.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array, Int64Array
from recast.geometry import se3
from recast.logs import DrivingLog, Trajectory
from recast.logs.checks import LATEST_US, WORLD_REACH
from recast.scene.actor import mirrored
from recast.splats import Gaussians, concatenate
from recast.splats.gaussians import C0, MAX_DEGREE, quat_multiply
from recast_bridges.scenes.checkpoint import (
    CheckpointTable,
    Names,
    read_faces,
    read_gaussians,
    read_harmonics,
)

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
    """Metres (3,) from the scene's origin to that of its map frame. Raises InputError: it is
    missing, or something else."""
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
    Raises InputError: they are of another shape, or out of range."""
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


SCENERY = ("VanillaGaussianSplattingModel", "SkyboxGaussianSplattingModel", GROUND)
RIGID, MIRRORED = "RigidSubModel", "MirroredRigidSubModel"
NAMES = Names("means", "features_rest", "scales", "quats", "opacities")
CONSTANT = "features_dc"
AWAY_M = 1000.0
"""Actors are put this high in frames in which they are absent."""
MOST_TERMS = 64
_ANGLES = 360


@dataclass(frozen=True)
class MtgsNode:
    """One model of the checkpoint."""

    token: str  # what the log calls an actor, or background or skybox
    kind: str  # class that the trainer had for it
    # config, state, gaussians: settings, poses and Gaussians.
    config: CheckpointTable
    state: CheckpointTable
    gaussians: CheckpointTable

    @classmethod
    def of(cls, root: CheckpointTable, name: str, token: str) -> MtgsNode:
        """The node `name` of a checkpoint. Raises InputError: it has no configuration, type or
        state."""
        own = root.table(name)
        config, state = own.table("config"), own.table("state_dict")
        prefix = "gauss_params"
        gaussians = state.table(prefix) if prefix in state else state.below(prefix)
        return cls(token, config.text("type"), config, state, gaussians)

    @property
    def changing(self) -> bool:
        """Whether its colours change."""
        return self.config.number("fourier_features_dim", 0) != 0


def fourier_terms(time: Tensor, terms: int, scale: float, angle: bool) -> Tensor:
    """MTGS' basis (..., F) at times in [0, 1], or at angles in radians.

    cos(i t w) for even i, sin((i + 1) t w) for odd i; w is 2 pi / F for times and 1 for angles.
    """
    order = torch.arange(terms, dtype=torch.float64)
    phase = time[..., None] * scale * (1.0 if angle else 2 * math.pi / terms)
    even = order % 2 == 0
    return torch.where(even, torch.cos(phase * order), torch.sin(phase * (order + 1)))


def read_gaussian_node(node: MtgsNode, share: float) -> Gaussians:
    """The Gaussians of a node in its own frame, harmonics in the axes of the scene.

    Args:
        share: share of the node's time at which changing colours are frozen.

    Raises:
        InputError: a field is missing, of another shape, not finite, or out of range.
    """
    config, table = node.config, node.gaussians
    degree = config.number("sh_degree")
    if degree not in range(MAX_DEGREE + 1):
        raise config.fault("sh_degree", f"is {degree:g}, expected 0 to {MAX_DEGREE}")
    count = len(table.tensor(NAMES.means, None, 3))
    constant = _constant(node, count, share)
    rest = read_harmonics(table, NAMES.rest, count, degree)
    changes = {NAMES.rest: rest}
    if degree == 0:  # these colours are a sigmoid, not harmonics around a half
        constant = (torch.sigmoid(constant) - 0.5) / C0
    sides = config.number("scale_dim", 3)
    if sides == 1:
        changes[NAMES.log_scales] = table.tensor(NAMES.log_scales, count, 1).expand(count, 3)
        changes[NAMES.quats] = torch.tensor([[1.0, 0, 0, 0]]).expand(count, 4)
    elif sides != 3:
        raise config.fault("scale_dim", f"is {sides:g}, expected 1 or 3")
    if node.kind == GROUND:
        changes |= ground_members(config, node.state, table, NAMES)
    found = read_gaussians(table.changed(changes), NAMES, constant)
    if node.kind != MIRRORED:
        return found
    return concatenate([found, mirrored(found, torch.ones(count, dtype=torch.bool))])


def _constant(node: MtgsNode, count: int, share: float) -> Tensor:
    """Constant colours (N, 3) at a share of the time, or averaged over all angles of view."""
    if not node.changing:
        return node.gaussians.tensor(CONSTANT, count, 3)
    given = node.config.number("fourier_features_dim")
    if given not in range(1, MOST_TERMS + 1):
        raise node.config.fault("fourier_features_dim", f"is {given:g}, not 1 to {MOST_TERMS}")
    terms = int(given)
    features = node.gaussians.tensor(CONSTANT, count, terms, 3)
    scale = node.config.number("fourier_features_scale", 1.0)
    angle = "fourier_in_space" in node.config and node.config.text("fourier_in_space") != "temporal"
    if angle:
        around = torch.arange(_ANGLES, dtype=torch.float64) * (2 * math.pi / _ANGLES)
        basis = fourier_terms(around, terms, scale, angle).mean(dim=0)
    else:
        basis = fourier_terms(torch.tensor(share, dtype=torch.float64), terms, scale, angle)
    return torch.einsum("f,nfc->nc", basis.to(features), features)


@dataclass(frozen=True)
class MtgsMotion:
    """Where an actor is."""

    trajectory: Trajectory  # `world_from_actor` in the frames in which it is there
    static: bool  # whether the actor has one pose for the whole drive
    gaps: bool  # whether the actor is absent between two of these frames

    def meets(self, log: DrivingLog) -> bool:
        """Whether it is there in the log's time."""
        first, last = log.world_from_rig.timestamps_us[[0, -1]]
        times = self.trajectory.timestamps_us
        return bool(times[0] <= last and times[-1] >= first)


def read_motion(node: MtgsNode, log: DrivingLog, world_from_scene: Array) -> MtgsMotion | None:
    """The places of an actor, or None if it is there in no frame, or in one of many.

    An actor with one pose for the whole drive has it at the log's first and last time.

    Raises:
        InputError: a member is missing, of another shape or not finite, or times do not increase.
    """
    state, config = node.state, node.config
    places = _rows(state, "instance_trans", 3)
    turns = _rows(state, "instance_quats", 4)
    if len(turns) != len(places):
        raise state.fault("instance_quats", f"has {len(turns)} rows, not {len(places)}")
    there = places[:, 2] < AWAY_M  # also not NaN
    if "instance_valid" in state:
        valid = state.array("instance_valid").reshape(-1)
        if len(valid) != len(there):
            raise state.fault("instance_valid", f"has {len(valid)} frames, not {len(there)}")
        there &= valid > 0.5
    rows, static = np.flatnonzero(there), len(places) == 1
    if len(rows) < (1 if static else 2):
        return None
    if not np.all(np.abs(places[rows]) <= WORLD_REACH):
        raise state.fault("instance_trans", "is not finite, or out of range")
    norms = np.linalg.norm(turns[rows], axis=1)
    if not np.all((norms > 1e-6) & (norms < 1e6)):
        raise state.fault("instance_quats", "holds a quaternion of norm zero, or not finite")
    poses = world_from_scene @ se3.from_rotation_translation(
        se3.quat_to_matrix(turns[rows]), places[rows]
    )
    if static:
        ends = log.world_from_rig.timestamps_us[[0, -1]].copy()
        return MtgsMotion(Trajectory(ends, np.repeat(poses, 2, axis=0)), static=True, gaps=False)
    times = config.array("log_timestamps").reshape(-1)
    if len(times) != len(places):
        raise config.fault("log_timestamps", f"has {len(times)} times for {len(places)} poses")
    own = times[rows]
    if not np.all((own >= 0) & (own < 2.0**53)) or not np.all(np.diff(own.round()) > 0):
        raise config.fault("log_timestamps", "are not microseconds that increase")
    gaps = bool(np.any(np.diff(rows) > 1))
    return MtgsMotion(Trajectory(own.round().astype(np.int64), poses), static=False, gaps=gaps)


def _rows(state: CheckpointTable, name: str, width: int) -> Array:
    """A row for each frame; axes of length one are dropped, as the renderer does."""
    found = state.array(name)
    rows = np.squeeze(found)
    if rows.ndim == 1:
        rows = rows[None]
    if rows.ndim != 2 or rows.shape[1] != width:
        raise state.fault(name, f"has shape {list(found.shape)}, expected [frames, {width}]")
    return rows
