"""The light that a vehicle's colours were recorded in, so that it can be lit anew.

What the log showed of a vehicle has the light of the places where it was seen. What is mirrored has
the light of the other side. What a generator invented has the colours of the sides that were seen,
in a light that is the same from all around.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from recast.actors.actor import Actor
from recast.actors.hull import outer_surface
from recast.actors.shares import Shares
from recast.logs import Trajectory
from recast.scene.dynamic import pose_at
from recast.scene.light import ActorLight, CastShadow, LitSurface, SceneLight, recorded_light
from recast.splats import Gaussians

Array = NDArray[np.float64]

_NEIGHBOURS = 6
_SPINE = 0.6  # share of the half length over which a vehicle's middle line runs
_EVEN = 0.6  # light that generators give to what faces sideways, over what faces up
_LOOK_DOWN = 0.25  # of the direction to a logged camera, vertical over level
_POSES = 8  # of a trajectory, at most
_LEAST_SEEN = 1e-3


def actor_light(scene: SceneLight, actor: Actor, trajectory: Trajectory) -> ActorLight:
    """What is needed to light an actor anew in a street.

    Args:
        trajectory: where the track was when the log saw it. For an actor that follows all images
            every pose counts the same; for one made of one image, the pose at that image.

    Raises:
        ValueError: the actor has no surface, see `outer_surface`.
    """
    hull = outer_surface(actor.gaussians)
    normals = _normals(actor.gaussians, hull.points, hull.normals)
    shares = actor.shares or _shares_of_view(normals, actor.provenance.azimuth)
    poses = list(trajectory.poses[:: -(-len(trajectory.poses) // _POSES)])
    if actor.shares is None:
        pose = pose_at(trajectory, actor.provenance.timestamp_us)
        poses = poses if pose is None else [pose]
    surface = LitSurface.of(normals, actor.gaussians.means, actor.size)
    recorded = _recorded(scene, actor, surface, shares, poses)
    shadow = CastShadow(hull.points, actor.shadow, actor.size) if len(actor.shadow) else None
    return ActorLight(scene, actor.gaussians, surface, recorded, shadow)


def _normals(gaussians: Gaussians, points: Array, normals: Array) -> Tensor:
    """Outward normals (N, 3) of all Gaussians: means over the nearest of the outer surface."""
    half = np.abs(points).max(axis=0)
    spine = np.stack(
        [np.clip(points[:, 0], -_SPINE * half[0], _SPINE * half[0]), 0 * points[:, 1],
         np.minimum(points[:, 2], 0)], axis=-1,
    )  # fmt: skip
    outward = normals * np.where(np.sum(normals * (points - spine), axis=1) < 0, -1.0, 1.0)[:, None]
    centres = gaussians.means.detach().cpu().numpy().astype(np.float64)
    near = outward[cKDTree(points).query(centres, k=_NEIGHBOURS)[1]].mean(axis=1)
    near /= np.maximum(np.linalg.norm(near, axis=1, keepdims=True), 1e-9)
    return torch.from_numpy(near).float()


def _shares_of_view(normals: Tensor, azimuth: float) -> Shares:
    """Shares of a vehicle made of one image: what faced the camera was seen."""
    look = torch.tensor([np.cos(azimuth), np.sin(azimuth), _LOOK_DOWN], dtype=torch.float32)
    look = look / look.norm()
    seen = (normals @ look).clamp(0, 1)
    return Shares(seen, (1 - seen) * (_mirror(normals) @ look).clamp(0, 1))


def _recorded(
    scene: SceneLight, actor: Actor, surface: LitSurface, shares: Shares, poses: Sequence[Array]
) -> Tensor:
    """Light (N,) that each Gaussian's colour was recorded in."""
    own = recorded_light(scene, surface, actor.size, poses)
    if float(shares.seen.sum()) < _LEAST_SEEN:
        return own
    other = LitSurface.of(_mirror(surface.normals), actor.gaussians.means, actor.size)
    twin = recorded_light(scene, other, actor.size, poses)
    even = _EVEN + (1 - _EVEN) * surface.normals[:, 2]
    level = (shares.seen * own / even).sum() / shares.seen.sum()
    return shares.seen * own + shares.mirrored * twin + shares.invented * level * even


def _mirror(normals: Tensor) -> Tensor:
    return normals * torch.tensor([1.0, -1.0, 1.0])
