"""Checkpoints of DriveStudio (`checkpoint_final.pth`), which trains OmniRe and others.

Source: Chen et al., "OmniRe: Omni Urban Scene Reconstruction" (2024), and the layout its trainer
saves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from recast.core.files import require_new
from recast.logs import DrivingLog
from recast.logs.importers.processed_folder import read_pose
from recast.scene.importers.actors import (
    SUSPICIOUS_M,
    TURNING,
    check_names,
    check_share,
    choose_tracks,
    colours_in_own_frame,
    read_track_names,
)
from recast.scene.importers.checkpoint import (
    NO_SKY,
    RESAMPLED,
    Table,
    read_checkpoint,
    read_faces,
    read_gaussians,
    unused_members,
)
from recast.scene.importers.drivestudio_tables import (
    CONSTANT,
    INSTANCES,
    NAMES,
    Instance,
    mean_affine,
    read_constant,
    read_instances,
)
from recast.scene.importers.placement import (
    Imported,
    ImportRecord,
    Placement,
    frame_times,
    given_placement,
    write_imported,
)
from recast.scene.sky import sky_from_cubemap
from recast.scene.street_scene import SceneActor, StreetScene
from recast.scene.trainable_parts import exposed, exposed_colours
from recast.splats import Gaussians

CUBE_FROM_SCENE = torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""The sky is looked up in direction (x, z, -y)."""
_LEFT_OUT = {
    "DeformableNodes": "actors that a network deforms (cyclists, far pedestrians)",
    "SMPLNodes": "pedestrians on a body model",
    "CamPose": "camera pose corrections of single images",
}


@dataclass(frozen=True)
class _Colours:
    """What is done to all colours: `affine` (3, 4), or nothing."""

    affine: Tensor | None

    def gaussians(self, part: Gaussians) -> Gaussians:
        return part if self.affine is None else exposed(part, self.affine)

    def sky(self, faces: Tensor) -> Tensor:
        return faces if self.affine is None else exposed_colours(faces, self.affine)


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
        log: of the drive it was trained on.
        processed: the folder it was trained on. It places the scene by the file of its first pose;
            without it the scene's origin is taken for the log's rig at the first frame.
        first_frame: the training's first time step.
        clock: sensor of the log whose frames the checkpoint's are; see `frame_times`.
        world_from_scene: text file with the scene's place in the log's world.
        tracks: JSON file with the log's track ids by actor, "0", "1", ...
        leave_out: actors not wanted.
        share: in [0, 1], of an actor's time in the scene: where its view-dependent colour is kept.

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
    colours = _Colours(mean_affine(models.table("Affine")) if "Affine" in models else None)
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
    wanted, dropped = _wanted(instances, leave_out)
    trajectories = {name: actor.trajectory for name, actor in wanted.items()}
    chosen, distance = choose_tracks(models, log, trajectories, given)
    actors = {}
    for name, track_id in chosen.items():
        actor = wanted[name]
        own = colours_in_own_frame(
            colours.gaussians(actor.gaussians), actor.trajectory, placement.world_from_scene, share
        )
        actors[track_id] = SceneActor(track_id, own, actor.size, actor.trajectory)
    pose = torch.from_numpy(placement.world_from_scene)
    faces = None
    if "Sky" in models:
        faces = colours.sky(read_faces(models.table("Sky"), "base"))
    imported = Imported(
        layout="drivestudio",
        scene=StreetScene(
            background=colours.gaussians(background).transformed(pose),
            actors=actors,
            sky=sky_from_cubemap(faces, CUBE_FROM_SCENE @ pose[:3, :3].T.float()),
            world_offset=log.world_offset,
            log_name=log.name,
        ),
        placement=placement,
        tracks=chosen,
        changed=tuple(_changed(models, chosen, distance)),
        left_out=(*dropped, *_left_out(models)),
        warnings=tuple(_warnings(distance)),
        iteration=root.integer("step") if "step" in root else None,
    )
    return write_imported(imported, Path(path), log, out)


def _placement(
    log: DrivingLog,
    start_us: int,
    first_frame: int,
    processed: Path | None,
    world_from_scene: Path | None,
) -> Placement:
    if world_from_scene is not None:
        return given_placement(world_from_scene)
    if processed is None:
        return Placement(
            log.world_from_rig.at(start_us),
            f"the log's rig at frame {first_frame} ({start_us} us), which is the origin "
            "where the rig is the vehicle frame of the training, as on Waymo",
        )
    name = f"ego_pose/{first_frame:03d}.txt"
    if not (processed / "ego_pose").is_dir():
        name = f"extrinsics/{first_frame:03d}_0.txt"  # the world is the first camera's first pose
    moved = read_pose(processed / name)
    moved[:3, 3] -= log.world_offset
    return Placement(moved, f"{name} of the processed folder")


def _wanted(
    instances: Mapping[str, Instance], leave_out: Sequence[str]
) -> tuple[dict[str, Instance], list[str]]:
    wanted, dropped = {}, []
    for name, instance in instances.items():
        if name in leave_out:
            dropped.append(f"actor {name}: asked to be left out")
        elif len(instance.gaussians) == 0:
            dropped.append(f"actor {name}: has no Gaussians")
        else:
            wanted[name] = instance
    return wanted, dropped


def _changed(models: Table, tracks: Mapping[str, str], distance: float) -> list[str]:
    changed = []
    if tracks:
        changed.append(TURNING)
        changed.append(
            f"actors were told to be tracks by their places, {distance:.2f} m off at most (median "
            "over an actor's time)"
        )
    if "Sky" in models:
        changed.append(RESAMPLED)
    if "Affine" in models:
        changed.append("the mean of the images' affine colours is part of all colours")
    return changed


def _warnings(distance: float) -> list[str]:
    if distance <= SUSPICIOUS_M:
        return []
    return [
        f"actors lie as far as {distance:.2f} m from their tracks: the first frame or the clock "
        "may be others"
    ]


def _left_out(models: Table) -> list[str]:
    left_out = [f"{name}: {what}" for name, what in _LEFT_OUT.items() if name in models]
    if "Sky" not in models:
        left_out.append(NO_SKY)
    if "Affine" in models:
        left_out.append("Affine: the colours of single images")
    parts = [models.table(name) for name in ("Background", "RigidNodes") if name in models]
    left_out += unused_members(parts, NAMES, (CONSTANT, *INSTANCES))
    known = ("Background", "RigidNodes", "Sky", "Affine", *_LEFT_OUT)
    return [*left_out, *(f"{name}: not known" for name in models if name not in known)]
