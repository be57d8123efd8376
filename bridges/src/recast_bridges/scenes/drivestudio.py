"""Checkpoints of DriveStudio (`checkpoint_final.pth`), which trains OmniRe and others.

Source: Chen et al., "OmniRe: Omni Urban Scene Reconstruction" (2024), and the layout its trainer
saves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array, Int64Array
from recast.core.files import require_new
from recast.geometry import se3
from recast.logs import DrivingLog, Trajectory
from recast.scene.actor import SceneActor, exposed, exposed_colours
from recast.scene.exchange import (
    ImportRecord,
    ScenePlacement,
    frame_times,
    given_placement,
    write_imported,
)
from recast.scene.sky import sky_from_cubemap
from recast.scene.street_scene import StreetScene
from recast.splats import Gaussians
from recast_bridges.logs.processed_folder import read_pose
from recast_bridges.scenes.actors import (
    SUSPICIOUS_M,
    TURNING,
    check_names,
    check_share,
    choose_tracks,
    colours_in_own_frame,
    read_track_names,
)
from recast_bridges.scenes.checkpoint import (
    NO_SKY,
    RESAMPLED,
    CheckpointTable,
    Names,
    read_checkpoint,
    read_faces,
    read_gaussians,
    unused_members,
)

NAMES = Names("_means", "_features_rest", "_scales", "_quats", "_opacities")
CONSTANT = "_features_dc"
INSTANCES = (
    "instances_quats",
    "instances_trans",
    "instances_fv",
    "instances_size",
    "points_ids",
)
CUBE_FROM_SCENE = torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""The sky is looked up in direction (x, z, -y)."""
_LEFT_OUT = {
    "DeformableNodes": "actors that a network deforms (cyclists, far pedestrians)",
    "SMPLNodes": "pedestrians on a body model",
    "CamPose": "camera pose corrections of single images",
}


def import_drivestudio(
    path: str | Path,
    log: DrivingLog,
    out: str | Path,
    *,
    processed: Path | None = None,
    first_frame: int = 0,
    clock: str | None = None,
    world_from_scene: Path | None = None,
    tracks: Path | None = None,
    leave_out: Sequence[str] = (),
    share: float = 0.5,
) -> ImportRecord:
    """Make a scene of a DriveStudio checkpoint: background, rigid actors and sky.

    The checkpoint does not tell which tracks its actors are; they are found by where they were.

    Args:
        log: log of the drive that the checkpoint was trained on.
        processed: the folder it was trained on. It places the scene by the file of its first pose;
            without it the scene's origin is taken for the log's rig at the first frame.
        first_frame: the training's first time step.
        clock: sensor of the log whose frames the checkpoint's are; see `frame_times`.
        world_from_scene: text file with the scene's place in the log's world.
        tracks: JSON file with the log's track ids by actor, "0", "1", ...
        leave_out: actors not wanted.
        share: share of an actor's time in the scene, in [0, 1], at which its view-dependent colour
            is kept.

    Raises:
        InputError: a file is missing, broken or of another layout, an actor is no track of the
            log, `out` exists. Nothing is written then.
    """
    check_share(share)
    require_new(out)
    root = read_checkpoint(path)
    models = root.table("models")
    times = frame_times(log, clock, first_frame)
    placement = _placement(log, int(times[0]), first_frame, processed, world_from_scene)
    affine = mean_affine(models.table("Affine")) if "Affine" in models else torch.eye(3, 4)
    table = models.table("Background")
    background = read_gaussians(table, NAMES, read_constant(table))
    if len(background) == 0:
        raise models.fault("Background", "has no Gaussians")
    instances: dict[str, Instance] = {}
    if "RigidNodes" in models:
        nodes = models.table("RigidNodes")
        instances = read_instances(nodes, times, placement.world_from_scene)
    given = read_track_names(tracks)
    check_names(root, list(instances), given, leave_out)
    wanted, left_out = {}, []
    for name, instance in instances.items():
        if name in leave_out:
            left_out.append(f"actor {name}: left out as requested")
        elif len(instance.gaussians) == 0:
            left_out.append(f"actor {name}: has no Gaussians")
        else:
            wanted[name] = instance
    trajectories = {name: actor.trajectory for name, actor in wanted.items()}
    chosen, distance = choose_tracks(models, log, trajectories, given)
    actors = {}
    for name, track_id in chosen.items():
        actor = wanted[name]
        own = colours_in_own_frame(
            exposed(actor.gaussians, affine), actor.trajectory, placement.world_from_scene, share
        )
        actors[track_id] = SceneActor(track_id, own, actor.size, actor.trajectory)
    pose = torch.from_numpy(placement.world_from_scene)
    faces = None
    if "Sky" in models:
        faces = exposed_colours(read_faces(models.table("Sky"), "base"), affine)
    sky = sky_from_cubemap(faces, CUBE_FROM_SCENE @ pose[:3, :3].T.float())
    far = (
        f"actors lie as far as {distance:.2f} m from their tracks: the first frame or the clock "
        "may be wrong"
    )
    return write_imported(
        Path(path),
        log,
        out,
        placement,
        StreetScene(exposed(background, affine).transformed(pose), actors, sky),
        layout="drivestudio",
        tracks=chosen,
        changed=_changed(models, chosen, distance),
        left_out=[*left_out, *_left_out(models)],
        warnings=[far] if distance > SUSPICIOUS_M else [],
        iteration=root.iteration("step"),
    )


def _placement(
    log: DrivingLog,
    start_us: int,
    first_frame: int,
    processed: Path | None,
    world_from_scene: Path | None,
) -> ScenePlacement:
    if world_from_scene is not None:
        return given_placement(world_from_scene)
    if processed is None:
        return ScenePlacement(
            log.world_from_rig.at(start_us),
            f"the log's rig at frame {first_frame} ({start_us} us), which is the origin "
            "where the rig is the vehicle frame of the training, as on Waymo",
        )
    name = f"ego_pose/{first_frame:03d}.txt"
    if not (processed / "ego_pose").is_dir():
        name = f"extrinsics/{first_frame:03d}_0.txt"  # the world is the first camera's first pose
    moved = read_pose(processed / name)
    moved[:3, 3] -= log.world_offset
    return ScenePlacement(moved, f"{name} of the processed folder")


def _changed(models: CheckpointTable, tracks: Mapping[str, str], distance: float) -> list[str]:
    changed = []
    if tracks:
        changed.append(TURNING)
        changed.append(
            f"actors were matched to tracks by their positions, {distance:.2f} m off at most "
            "(median over an actor's time)"
        )
    if "Sky" in models:
        changed.append(RESAMPLED)
    if "Affine" in models:
        changed.append("the mean of the images' affine colours is part of all colours")
    return changed


def _left_out(models: CheckpointTable) -> list[str]:
    left_out = [f"{name}: {what}" for name, what in _LEFT_OUT.items() if name in models]
    if "Sky" not in models:
        left_out.append(NO_SKY)
    if "Affine" in models:
        left_out.append("Affine: the colours of single images")
    parts = [models.table(name) for name in ("Background", "RigidNodes") if name in models]
    left_out += unused_members(parts, NAMES, (CONSTANT, *INSTANCES))
    known = ("Background", "RigidNodes", "Sky", "Affine", *_LEFT_OUT)
    return [*left_out, *(f"{name}: not known" for name in models if name not in known)]


@dataclass(frozen=True)
class Instance:
    """One rigid actor."""

    gaussians: Gaussians  # Gaussians in the box frame; harmonics in the axes of the scene
    size: Array  # (3,) length, width, height in metres
    trajectory: Trajectory  # `world_from_actor` at the frames in which it is there


def read_constant(table: CheckpointTable) -> Tensor:
    """Constant harmonics (N, 3)."""
    return table.tensor(CONSTANT, None, 3)


def read_instances(
    table: CheckpointTable, times_us: Int64Array, world_from_scene: Array
) -> dict[str, Instance]:
    """The actors of `RigidNodes` that are there in any frame, by their index as text.

    Args:
        times_us: times of the log's frames in microseconds, the checkpoint's first one first.

    Raises:
        InputError: a tensor is missing, of another shape or not finite, a point belongs to no
            actor, or the log has fewer frames.
    """
    gaussians = read_gaussians(table, NAMES, read_constant(table))
    translations = table.tensor("instances_trans", None, None, 3, dtype=torch.float64)
    frames, count = translations.shape[:2]
    quats = table.tensor("instances_quats", frames, count, 4).double().numpy()
    present = table.tensor("instances_fv", frames, count).numpy() > 0.5
    sizes = table.tensor("instances_size", count, 3).double().numpy()
    owner = table.tensor("points_ids", len(gaussians), 1)[:, 0].long()
    if len(owner) and not 0 <= int(owner.min()) <= int(owner.max()) < count:
        raise table.fault("points_ids", f"names an actor that is not one of {count}")
    if frames > len(times_us):
        raise table.fault(
            "instances_trans",
            f"has {frames} frames, the log {len(times_us)} from its first one",
            "give the log it was trained on, and the first frame (`first_frame`)",
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


def mean_affine(table: CheckpointTable) -> Tensor:
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
