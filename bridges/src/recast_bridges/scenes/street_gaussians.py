"""Streets of Street Gaussians: the checkpoint, and the tracks with its learned corrections.

The checkpoint stores corrections by frame and slot. Slots are assigned while the label file is
read, so the assignment is repeated here, and so is the way in which poses are read out, with its
peculiarities: a learned yaw is applied twice, and the second of the two rotations interpolated
between starts from the first one and is read in its row.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import read_json, require_new
from recast.geometry import se3
from recast.logs import DrivingLog, Trajectory
from recast.scene.actor import SceneActor, fourier_basis
from recast.scene.exchange import (
    ImportRecord,
    ScenePlacement,
    frame_times,
    given_placement,
    write_imported,
)
from recast.scene.sky import sky_from_cubemap
from recast.scene.street_scene import StreetScene, moves
from recast.splats import Gaussians
from recast_bridges.logs.processed_folder import CAMERAS, frame_numbers, read_pose
from recast_bridges.logs.street_gaussians import CATEGORIES, read_box_rows
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

_MEND = "give the folder that the checkpoint was trained on"

Boxes = dict[int, dict[int, Array]]


@dataclass(frozen=True)
class ProcessedDrive:
    """What the importer needs of the folder."""

    folder: Path  # folder of the processed drive, for messages
    # first, last: frames of the training, both included.
    first: int
    last: int
    camera: str  # name of its first camera, at whose times actors are placed
    offset: Array  # (3,) dataset coordinates of the scene's origin
    # boxes by track number and frame: x, y, z, heading in the vehicle frame.
    boxes: Mapping[int, Mapping[int, Array]]
    slots: Mapping[tuple[int, int], int]  # slots by track number and frame
    slot_count: int  # number of slots of a frame
    # frame_seconds, camera_seconds: times of the frame and of its camera image by frame, seconds.
    frame_seconds: Mapping[int, float]
    camera_seconds: Mapping[int, float]
    dataset_from_vehicle: Mapping[int, Array]  # (4, 4) vehicle poses by frame, at the camera's time
    numbers: Mapping[str, int]  # track number by dataset id

    @property
    def frame_count(self) -> int:
        """Frames of the training."""
        return self.last - self.first + 1

    def trajectory(
        self,
        number: int,
        translations: Tensor,
        rotations: Tensor,
        world_from_scene: Array,
        log: DrivingLog,
    ) -> Trajectory:
        """Where the trained scene shows an actor at the times of its first camera.

        Args:
            number: number of the track.
            translations, rotations: (F, M, 3) metres and (F, M, 1), as learned.
            world_from_scene: (4, 4).

        Returns:
            `world_from_actor`.

        Raises:
            InputError: the actor has no moving box in these frames, or a time is not the log's.
        """
        boxes = self.boxes.get(number, {})
        frames = sorted(frame for frame in boxes if (number, frame) in self.slots)
        if not frames:
            raise InputError(
                self.folder / "track" / "track_info.txt",
                f"track {number}",
                f"has no box that moves in frames {self.first} to {self.last}",
                _MEND,
            )
        times, poses = [], []
        scene_from_dataset = se3.from_rotation_translation(np.eye(3), -self.offset)
        for frame in frames:
            pose = self._in_vehicle(number, frames, frame, translations, rotations)
            times.append(round(self.camera_seconds[frame] * 1e6))
            poses.append(
                world_from_scene @ scene_from_dataset @ self.dataset_from_vehicle[frame] @ pose
            )
        for time in (times[0], times[-1]):
            if not log.world_from_rig.covers(time):
                raise InputError(
                    self.folder / "timestamps.json",
                    self.camera,
                    f"{time} us is not within log {log.name}",
                    "give the log of the same drive",
                )
        return Trajectory(np.array(times, np.int64), np.stack(poses))

    def _in_vehicle(
        self,
        number: int,
        frames: Sequence[int],
        frame: int,
        translations: Tensor,
        rotations: Tensor,
    ) -> Array:
        """Pose (4, 4) at the camera's time, between the two labels nearest to it."""
        seconds = self.camera_seconds[frame]
        near = sorted(frames, key=lambda other: abs(self.frame_seconds[other] - seconds))[:2]
        first, second = min(near), max(near)
        span = self.frame_seconds[second] - self.frame_seconds[first]
        ratio = 0.0 if span == 0 else (seconds - self.frame_seconds[first]) / span
        ratio = min(max(ratio, 0.0), 1.0)

        def learned(values: Tensor, row: int, slot_of: int) -> Array:
            found: Array = values[row - self.first, self.slots[number, slot_of]].numpy()
            return found.astype(np.float64)

        boxes = self.boxes[number]
        places = [boxes[at][:3] + learned(translations, at, at) for at in (first, second)]
        # Both turns are read in the first frame's row, and each turns by twice its value.
        turns = [2 * float(learned(rotations, first, at)[0]) for at in (first, second)]
        yaw = boxes[first][3] + turns[0] + ratio * turns[1]
        place = (1 - ratio) * places[0] + ratio * places[1]
        return se3.from_rotation_translation(se3.rotation_z(yaw), place)


def read_processed(
    folder: str | Path, frames: tuple[int, int] | None, cameras: Sequence[int]
) -> ProcessedDrive:
    """Read poses, times and labels, and assign the slots.

    Args:
        frames: first and last of the training; all of the folder's if None.
        cameras: numbers of the cameras of the training, the first one first.

    Raises:
        InputError: a file is missing or broken, or frames or cameras are not there.
    """
    folder = Path(folder)
    paths = frame_numbers(folder / "ego_pose")
    listed = list(paths)
    first, last = frames or (listed[0], listed[-1])
    chosen = range(first, last + 1)
    if not chosen or any(frame not in paths for frame in chosen):
        raise InputError(
            folder,
            f"frames {first} to {last}",
            f"not all of them are in ego_pose, which has "
            f"{len(listed)} from {listed[0]} to {listed[-1]}",
            "choose other frames (`frames`)",
        )
    if not cameras or any(not 0 <= camera < len(CAMERAS) for camera in cameras):
        raise InputError(folder, f"cameras {list(cameras)}", "of 0 to 4", "name others")
    poses = {frame: read_pose(path) for frame, path in paths.items()}
    camera = CAMERAS[cameras[0]]
    boxes, slots, count = read_boxes(folder / "track", chosen, cameras, poses)
    return ProcessedDrive(
        folder=folder,
        first=first,
        last=last,
        camera=camera,
        offset=np.mean([pose[:3, 3] for pose in poses.values()], axis=0),
        boxes=boxes,
        slots=slots,
        slot_count=count,
        frame_seconds=_seconds(folder, "FRAME", chosen),
        camera_seconds=_seconds(folder, camera, chosen),
        dataset_from_vehicle={
            frame: read_pose(folder / "ego_pose" / f"{frame:06d}_{cameras[0]}.txt")
            for frame in chosen
        },
        numbers=_numbers(folder / "track" / "track_ids.json"),
    )


def _seconds(folder: Path, name: str, frames: Sequence[int]) -> dict[int, float]:
    path = folder / "timestamps.json"
    value = read_json(path)
    try:
        seconds = {frame: float(value[name][f"{frame:06d}"]) for frame in frames}
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(path, name, f"lacks a time ({error})", _MEND) from None
    steps = np.diff(list(seconds.values()))
    if not (np.isfinite(list(seconds.values())).all() and np.all(steps > 0)):
        raise InputError(path, name, "does not increase from frame to frame", _MEND)
    return seconds


def _numbers(path: Path) -> dict[str, int]:
    value = read_json(path)
    if not isinstance(value, dict) or not all(isinstance(n, int) for n in value.values()):
        raise InputError(path, "JSON", "is not an object of track numbers", _MEND)
    return value


def read_boxes(
    folder: Path, frames: Sequence[int], cameras: Sequence[int], poses: Mapping[int, Array]
) -> tuple[Boxes, dict[tuple[int, int], int], int]:
    """Boxes seen by the cameras, in the vehicle frame, and their slots.

    Args:
        folder: folder with track_info.txt and track_camera_vis.json.
        poses: (4, 4) ego poses by frame.

    Returns:
        x, y, z, heading by track number and frame; slots by track number and frame, of the tracks
        that move; slots a frame has.

    Raises:
        InputError: a file is missing or broken.
    """
    path = folder / "track_info.txt"
    seen_by = _visibility(folder / "track_camera_vis.json")
    boxes: Boxes = {}
    rows: list[tuple[int, int]] = []
    for row in read_box_rows(path, _MEND):
        if row.kind not in CATEGORIES or row.frame not in frames:
            continue
        try:
            track = int(row.track)
        except ValueError:
            problem = f"{row.track!r} is not a number"
            raise InputError(path, f"{row.where}: track", problem, _MEND) from None
        if not seen_by.get((track, row.frame), frozenset()) & set(cameras):
            continue
        boxes.setdefault(track, {})[row.frame] = np.array([*row.centre, row.heading])
        rows.append((track, row.frame))
    moving = {track for track, own in boxes.items() if moves(_in_world(own, poses))}
    slots, count = assign_slots(rows, moving)
    return boxes, slots, count


def assign_slots(
    rows: Sequence[tuple[int, int]], moving: set[int]
) -> tuple[dict[tuple[int, int], int], int]:
    """Slots of (track, frame) rows, in the order of the file, and how many a frame has.

    Each row takes the first free slot of its frame; then tracks that stand still are taken out. If
    fewer slots suffice now, each frame is closed up in order, else the holes stay.
    """
    by_frame: dict[int, list[int]] = {}
    for track, frame in rows:
        by_frame.setdefault(frame, []).append(track)
    before = max(map(len, by_frame.values()), default=0)
    kept = {frame: [t for t in tracks if t in moving] for frame, tracks in by_frame.items()}
    after = max(map(len, kept.values()), default=0)
    places = kept if after < before else by_frame
    slots = {
        (track, frame): slot
        for frame, tracks in places.items()
        for slot, track in enumerate(tracks)
        if track in moving
    }
    return slots, after


def _in_world(boxes: Mapping[int, Array], poses: Mapping[int, Array]) -> Trajectory:
    frames = sorted(boxes)
    own = [se3.from_rotation_translation(np.eye(3), boxes[frame][:3]) for frame in frames]
    placed = [poses[frame] @ pose for frame, pose in zip(frames, own, strict=True)]
    return Trajectory(np.array(frames, np.int64), np.stack(placed))


def _visibility(path: Path) -> dict[tuple[int, int], frozenset[int]]:
    """Numbers of the cameras that see a track in a frame."""
    value: Any = read_json(path)
    try:
        return {
            (int(track), int(frame)): frozenset(int(camera) for camera in cameras)
            for track, frames in value.items()
            for frame, cameras in frames.items()
        }
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            path, "JSON", f"is not a table of cameras by track and frame ({error})", _MEND
        ) from None


# Checkpoints of Street Gaussians (`trained_model/iteration_N.pth`).
#
# Source: Yan et al., "Street Gaussians: Modeling Dynamic Urban Scenes with Gaussian Splatting"
# (ECCV 2024), and the layout its trainer saves.

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
