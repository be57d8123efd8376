"""Checkpoints of Street Gaussians (`trained_model/iteration_N.pth`).

Source: Yan et al., "Street Gaussians: Modeling Dynamic Urban Scenes with Gaussian Splatting" (ECCV
2024), and the layout its trainer saves.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from recast.core.files import require_new
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.scene.actor import SceneActor
from recast.scene.appearance import fourier_basis
from recast.scene.imported import (
    ImportRecord,
    ScenePlacement,
    frame_times,
    given_placement,
    write_imported,
)
from recast.scene.sky import sky_from_cubemap
from recast.scene.street_scene import StreetScene
from recast.splats import Gaussians
from recast_bridges.scenes.actors import (
    TURNING,
    check_names,
    check_share,
    colours_in_own_frame,
    read_track_names,
    track_of,
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
from recast_bridges.scenes.street_gaussians_tracks import ProcessedDrive, read_processed

NAMES = Names("xyz", "feature_rest", "scaling", "rotation", "opacity")
CONSTANT = "feature_dc"
OBJECT = re.compile(r"obj_([0-9]{1,9})")
KNOWN = ("iter", "background", "actor_pose", "sky_cubemap", "color_correction", "pose_correction")
_UNUSED = {
    "color_correction": "colour corrections of single images",
    "pose_correction": "camera pose corrections, which move the background",
}


def import_street_gaussians(
    path: str | Path,
    log: DrivingLog,
    out: str | Path,
    *,
    processed: Path | None = None,
    frames: tuple[int, int] | None = None,
    cameras: Sequence[int] = (0, 1, 2),
    world_from_scene: Path | None = None,
    tracks: Path | None = None,
    leave_out: Sequence[str] = (),
    share: float = 0.5,
) -> ImportRecord:
    """Make a scene of a Street Gaussians checkpoint.

    Args:
        log: log of the drive that the checkpoint was trained on.
        processed: the folder it was trained on, with `ego_pose` and `track`. It places the scene
            exactly and gives the learned corrections of tracks their meaning; without it the
            scene's origin is taken for the mean recorded ego position and actors follow the log.
        frames: first and last frame of the training, both included; all of the folder's if None.
        cameras: numbers of the cameras of the training.
        world_from_scene: text file with the scene's place in the log's world.
        tracks: JSON file with the log's track ids by the checkpoint's names.
        leave_out: names of actors not wanted.
        share: share of an actor's time in the scene, in [0, 1], at which its changing colour is
            frozen.

    Raises:
        InputError: a file is missing, broken or of another layout, an actor is no track of the
            log, `out` exists. Nothing is written then.
    """
    check_share(share)
    require_new(out)
    table = read_checkpoint(path)
    drive = None if processed is None else read_processed(processed, frames, cameras)
    placement = _placement(log, drive, world_from_scene)
    names = sorted(name for name in table if OBJECT.fullmatch(name))
    given = read_track_names(tracks)
    check_names(table, names, given, leave_out)
    background = _gaussians(table.table("background"), share)
    if len(background) == 0:
        raise table.fault("background", "has no Gaussians")
    corrections = _corrections(table, drive)
    actors: dict[str, SceneActor] = {}
    by_name: dict[str, str] = {}
    left_out = [f"{name}: left out as requested" for name in leave_out]
    for name in (name for name in names if name not in leave_out):
        gaussians = _gaussians(table.table(name), share)
        if len(gaussians) == 0:
            left_out.append(f"{name}: has no Gaussians")
            continue
        track = track_of(table, log, name, _candidates(name, given, drive))
        if track.track_id in actors:
            raise table.fault(name, f"is track {track.track_id}, as another actor is")
        trajectory = track.trajectory
        if drive is not None:
            number = int(name.removeprefix("obj_"))
            trajectory = drive.trajectory(number, *corrections, placement.world_from_scene, log)
        own = colours_in_own_frame(gaussians, trajectory, placement.world_from_scene, share)
        actors[track.track_id] = SceneActor(track.track_id, own, track.size, trajectory)
        by_name[name] = track.track_id
    pose = torch.from_numpy(placement.world_from_scene)
    faces = None
    if "sky_cubemap" in table:
        faces = read_faces(table.table("sky_cubemap").table("params"), "sky_cube_map")
    sky = sky_from_cubemap(faces, pose[:3, :3].T)
    return write_imported(
        Path(path),
        log,
        out,
        placement,
        StreetScene(background.transformed(pose), actors, sky),
        layout="street-gaussians",
        tracks=by_name,
        changed=_changed(table, by_name, share, drive),
        left_out=[*left_out, *_left_out(table, drive)],
        iteration=table.iteration("iter"),
    )


def frozen_constant(constant: Tensor, share: float) -> Tensor:
    """Constant harmonics (N, 3) at a share of the time, of Fourier coefficients (N, F, 3)."""
    basis = fourier_basis(share, constant.shape[1]).to(constant)
    return torch.einsum("k,nkc->nc", basis, constant)


def _gaussians(table: CheckpointTable, share: float) -> Gaussians:
    count = len(table.tensor(NAMES.means, None, 3))
    constant = table.tensor(CONSTANT, count, None, 3)
    if constant.shape[1] == 0:
        raise table.fault(CONSTANT, "has no coefficients")
    return read_gaussians(table, NAMES, frozen_constant(constant, share))


def _placement(
    log: DrivingLog, drive: ProcessedDrive | None, world_from_scene: Path | None
) -> ScenePlacement:
    if world_from_scene is not None:
        return given_placement(world_from_scene)
    if drive is not None:
        shift = se3.from_rotation_translation(torch.eye(3), drive.offset - log.world_offset)
        return ScenePlacement(shift, "mean of the ego positions in the processed folder")
    times = frame_times(log, None)
    mean = log.world_from_rig.at(times)[:, :3, 3].mean(axis=0)
    return ScenePlacement(
        se3.from_rotation_translation(torch.eye(3), mean),
        f"mean of {len(times)} ego positions of the log, which only approximates the mean over the "
        "frames of the processed folder; give that folder for the exact place",
    )


def _corrections(table: CheckpointTable, drive: ProcessedDrive | None) -> tuple[Tensor, Tensor]:
    """Learned offsets (F, M, 3) and turns (F, M, 1) of tracks; checked against the folder."""
    if drive is None:
        return torch.zeros(0, 0, 3), torch.zeros(0, 0, 1)
    shape = (drive.frame_count, drive.slot_count)
    if "actor_pose" not in table:
        return torch.zeros(*shape, 3), torch.zeros(*shape, 1)
    parameters = table.table("actor_pose").table("params")
    translations = parameters.tensor("opt_trans", None, None, 3)
    if tuple(translations.shape[:2]) != shape:
        raise parameters.fault(
            "opt_trans",
            f"is for {list(translations.shape[:2])} frames and slots, the processed folder has "
            f"{list(shape)} in the frames and cameras named",
            "name those of the training (`frames`, `cameras`)",
        )
    return translations, parameters.tensor("opt_rots", *shape, 1)


def _candidates(name: str, given: Mapping[str, str], drive: ProcessedDrive | None) -> list[str]:
    """Ids that the track of an actor may have in the log, the surest first."""
    if name in given:
        return [given[name]]
    number = int(name.removeprefix("obj_"))
    listed = {} if drive is None else drive.numbers
    return [*(id for id, value in listed.items() if value == number), str(number)]


def _changed(
    table: CheckpointTable, names: Mapping[str, str], share: float, drive: ProcessedDrive | None
) -> list[str]:
    changed = []
    if names:
        changed.append(TURNING)
    fourier = [
        name for name in names if table.table(name).tensor(CONSTANT, None, None, 3).shape[1] > 1
    ]
    if fourier:
        changed.append(
            f"colours of {', '.join(fourier)} change with time; they are frozen at {share:g} of it"
        )
    if drive is not None and "actor_pose" in table:
        changed.append(f"learned track corrections, as camera {drive.camera} saw them")
    if "sky_cubemap" in table:
        changed.append(RESAMPLED)
    return changed


def _left_out(table: CheckpointTable, drive: ProcessedDrive | None) -> list[str]:
    left_out = [f"{name}: {what}" for name, what in _UNUSED.items() if name in table]
    if "sky_cubemap" not in table:
        left_out.append(NO_SKY)
    if "actor_pose" in table and drive is None:
        left_out.append("actor_pose: its slots mean nothing without the processed folder")
    models = [table.table(n) for n in table if n == "background" or OBJECT.fullmatch(n)]
    # Nearly always there and without a column; its width tells whether semantics were learned.
    semantics = [m for m in models if "semantic" in m and m.tensor("semantic", None, None).numel()]
    left_out += unused_members(models, NAMES, (CONSTANT, *([] if semantics else ["semantic"])))
    strangers = [name for name in table if name not in KNOWN and not OBJECT.fullmatch(name)]
    return [*left_out, *(f"{name}: not known" for name in strangers)]
