"""DriveStudio's tables: fields of Gaussians, the rigid actors in one table, affine colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from recast.geometry import se3
from recast.logs import Trajectory
from recast.scene.importers.checkpoint import Names, Table, read_gaussians
from recast.scene.importers.placement import Array, Int64Array
from recast.splats import Gaussians

NAMES = Names("_means", "_features_rest", "_scales", "_quats", "_opacities")
CONSTANT = "_features_dc"
INSTANCES = (
    "instances_quats",
    "instances_trans",
    "instances_fv",
    "instances_size",
    "points_ids",
)


@dataclass(frozen=True)
class Instance:
    """One rigid actor.

    Attributes:
        gaussians: box frame; harmonics in the axes of the scene.
        size: (3,) length, width, height in metres.
        trajectory: `world_from_actor` at the frames in which it is there.
    """

    gaussians: Gaussians
    size: Array
    trajectory: Trajectory


def read_constant(table: Table) -> Tensor:
    """Constant harmonics (N, 3)."""
    return table.tensor(CONSTANT, None, 3)


def read_instances(
    table: Table, times_us: Int64Array, world_from_scene: Array
) -> dict[str, Instance]:
    """The actors of `RigidNodes` that are there in any frame, by their index as text.

    Args:
        times_us: of the log's frames, the checkpoint's first one first.

    Raises:
        InputError: a tensor is missing, of another shape or not finite, a point belongs to no
            actor, or the log has fewer frames.
    """
    gaussians = read_gaussians(table, NAMES, read_constant(table))
    translations = table.tensor("instances_trans", None, None, 3)
    frames, count = translations.shape[:2]
    quats = table.tensor("instances_quats", frames, count, 4).double().numpy()
    present = table.tensor("instances_fv", frames, count).numpy() > 0.5
    sizes = table.tensor("instances_size", count, 3).double().numpy()
    owner = table.tensor("points_ids", len(gaussians), 1)[:, 0].long()
    if len(owner) and not 0 <= int(owner.min()) <= int(owner.max()) < count:
        raise table.fault("points_ids", f"names an actor that is none of {count}")
    if frames > len(times_us):
        raise table.fault(
            "instances_trans",
            f"has {frames} frames, the log {len(times_us)} from its first one",
            "give the log it was trained on, and the first frame (--first-frame)",
        )
    if np.any(np.linalg.norm(quats[present], axis=-1) == 0):
        raise table.fault("instances_quats", "holds a quaternion of norm zero")
    found = {}
    for index in range(count):
        rows = np.flatnonzero(present[:, index])
        if len(rows) == 0:
            continue
        if not np.all(sizes[index] > 0):
            raise table.fault("instances_size", f"of actor {index} is {sizes[index].tolist()}")
        rotation = se3.quat_to_matrix(quats[rows, index])
        place = translations[rows, index].double().numpy()
        poses = world_from_scene @ se3.from_rotation_translation(rotation, place)
        found[str(index)] = Instance(
            gaussians.select(owner == index), sizes[index], Trajectory(times_us[rows], poses)
        )
    return found


def mean_affine(table: Table) -> Tensor:
    """The colour transform (3, 4) that the trainer uses for views it was not trained on.

    [I | 0] plus a network's output for the mean of the images' embeddings: one hidden layer with
    ReLU.

    Raises:
        InputError: a tensor is missing, of another shape, or not finite.
    """
    embeddings = table.tensor("embedding.weight", None, None)
    if len(embeddings) == 0:
        raise table.fault("embedding.weight", "has no rows")
    inner = table.tensor("decoder.0.weight", None, embeddings.shape[1])
    hidden = torch.relu(inner @ embeddings.mean(dim=0) + table.tensor("decoder.0.bias", len(inner)))
    outer = table.tensor("decoder.2.weight", 12, len(inner))
    residual = outer @ hidden + table.tensor("decoder.2.bias", 12)
    return torch.eye(3, 4) + residual.view(3, 4)
