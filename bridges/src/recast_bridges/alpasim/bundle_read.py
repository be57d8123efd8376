"""The members of AlpaSim's scene bundles as its runtime reads them; all others are left alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError

from recast.arrays import Array
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.files import parse_json
from recast.core.records import validated, validation_error
from recast.core.yaml_lines import read_yaml
from recast.geometry import se3
from recast.logs import checks
from recast.logs.checks import refused
from recast.logs.hdmap import parse_map
from recast.logs.importers.common import (
    ForeignRecord,
    chosen_cameras,
    first_jump,
    returns_valid,
    unknown_drive,
)
from recast.logs.types import CameraStream, DrivingLog, Track, Trajectory
from recast_bridges.alpasim.bundle import LABELS, MAP, METADATA, PINHOLE, RIG, TRACKS, read_usdz

_Text = str | float  # YAML takes 26.04 for a number
_Time = Annotated[int, Field(ge=-checks.LATEST_US, lt=checks.LATEST_US)]
_Pixels = Annotated[int, Field(gt=0, lt=1 << 20)]
_Two = tuple[float, float]
_Three = tuple[float, float, float]
_Four = tuple[float, float, float, float]
_Six = tuple[float, float, float, float, float, float]
_Seven = tuple[float, float, float, float, float, float, float]
Matrix = tuple[_Four, _Four, _Four, _Four]


class _Sensors(ForeignRecord):
    camera_ids: list[str]
    lidar_ids: list[str]


class _TimeRange(ForeignRecord):
    start: float
    end: float


class Metadata(ForeignRecord):
    """`metadata.yaml`."""

    scene_id: Annotated[str, Field(min_length=1, max_length=checks.NAME_LIMIT)]
    version_string: _Text
    training_date: _Text
    dataset_hash: _Text
    uuid: _Text
    is_resumable: bool
    sensors: _Sensors
    logger: dict[str, Any]
    time_range: _TimeRange


class PinholeParameters(ForeignRecord):
    """Parameters of an `opencv-pinhole` camera."""

    resolution: tuple[_Pixels, _Pixels]
    external_distortion_parameters: dict[str, Any] | None = None
    principal_point: _Two
    focal_length: _Two
    radial_coeffs: _Six
    tangential_coeffs: _Two
    thin_prism_coeffs: _Four


class _CameraModel(ForeignRecord):
    type: str
    parameters: dict[str, Any]


class BundleCamera(ForeignRecord):
    """A camera: where it is, and its model."""

    logical_sensor_name: str
    T_sensor_rig: Matrix
    camera_model: _CameraModel


class _WorldToNre(ForeignRecord):
    matrix: Matrix


class RigTrajectory(ForeignRecord):
    """Poses of the rig, and the times of the frames."""

    sequence_id: str
    T_rig_world_timestamps_us: list[_Time]
    T_rig_worlds: list[Matrix]
    cameras_frame_timestamps_us: dict[str, list[tuple[_Time, _Time]]]


class RigTrajectories(ForeignRecord):
    """`rig_trajectories.json`: the ego and its cameras, of one drive."""

    world_to_nre: _WorldToNre
    camera_calibrations: dict[str, BundleCamera]
    rig_trajectories: Annotated[list[RigTrajectory], Field(min_length=1, max_length=1)]


class TracksData(ForeignRecord):
    """Lists with an entry for each track."""

    tracks_id: list[str]
    tracks_label_class: list[str]
    tracks_flags: list[Any]
    tracks_timestamps_us: list[list[_Time]]
    tracks_poses: list[list[_Seven]]


class _Cuboids(ForeignRecord):
    cuboids_dims: list[_Three]


class TrackSequence(ForeignRecord):
    """The tracks of a drive."""

    tracks_data: TracksData
    cuboidtracks_data: _Cuboids


class Tracks(ForeignRecord):
    """`sequence_tracks.json`, below the key "sequences"."""

    sequences: Annotated[dict[str, TrackSequence], Field(min_length=1, max_length=1)]


# The log in a scene bundle of AlpaSim: poses, calibration, tracks and recast's own map.
#
# As in the runtime, poses are taken as they are and `world_to_nre` is applied to nothing. A bundle
# holds no images: cameras come with their calibration and without frames.

LIMITS = {METADATA: 1 << 18, RIG: 1 << 26, TRACKS: 1 << 26, MAP: 1 << 26}
"""Most bytes of a member. Text becomes some ten times as many bytes of numbers."""
CATEGORIES = {label: category for category, label in reversed(LABELS.items())} | {
    "rider": "cyclist",
    "stroller": "pedestrian",
    "trolley_bus": "bus",
}
"""Categories by AlpaSim's label classes; all others are `UNKNOWN`."""
UNKNOWN = "misc"
NO_CAMERA = "none"
"""Given as the only camera: imports none."""

_UNIT = 1e-3
"""Farthest that the norm of a quaternion, or an entry of a rotation, may be off: all were float32
once."""
_MEND = "give a bundle that AlpaSim can read"


@returns_valid
def load_alpasim(
    root: Path, drive: str = "", labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """The log of a bundle; a `recast.logs.importers.LogImporter`.

    Labels before the first and after the last pose of the ego are left out.

    Args:
        root: the USDZ file.
        drive: the scene's id, or empty: a bundle has one scene.
        labels: not known here.
        cameras: names of the cameras to import; all if empty; `("none",)` imports none.

    Raises:
        InputError: no such file, or any of its members, fields, numbers or names is none that a log
            can have; a camera is no pinhole camera with k1 k2 p1 p2 k3; there are labels.
    """
    if labels is not None:
        raise InputError(
            "importer", "`labels`", "are already in the bundle", "leave the option out"
        )
    members = read_usdz(root, LIMITS)
    for name in (METADATA, RIG, TRACKS):
        if name not in members:
            raise InputError(root, f"member {name}", "is missing", _MEND)
    metadata = _read_metadata(root / METADATA, members[METADATA])
    if drive and drive != metadata.scene_id:
        raise unknown_drive(root, drive, [metadata.scene_id], "")
    rig = validated(root / RIG, parse_json(root / RIG, members[RIG]), RigTrajectories, _MEND)
    ego = _ego(root / RIG, rig.rig_trajectories[0])
    streams = _cameras(root / RIG, rig, cameras)
    found = {"sequences": parse_json(root / TRACKS, members[TRACKS])}
    [sequence] = validated(root / TRACKS, found, Tracks, _MEND).sequences.values()
    return DrivingLog(
        name=metadata.scene_id,
        cameras=streams,
        lidars={},
        world_from_rig=ego,
        tracks=_tracks(root / TRACKS, sequence, ego),
        map=parse_map(root / MAP, parse_json(root / MAP, members[MAP])) if MAP in members else None,
        metadata={
            "dataset": "AlpaSim scene bundle",
            "version": str(metadata.version_string),
            "uuid": str(metadata.uuid),
        },
    )


def _read_metadata(where: Path, data: bytes) -> Metadata:
    try:
        value = read_yaml(data, str(where)).plain
    except InputError as error:
        raise InputError(error.where, error.field, error.problem, _MEND) from None
    return validated(where, value, Metadata, _MEND)


def _ego(where: Path, rig: RigTrajectory) -> Trajectory:
    field = "rig_trajectories.0"
    with refused(where, _MEND):
        times = np.array(rig.T_rig_world_timestamps_us, np.int64)
        checks.check_times(f"{field}.T_rig_world_timestamps_us", times)
        if len(times) < 2 or len(rig.T_rig_worlds) != len(times):
            counts = f"has {len(rig.T_rig_worlds)} poses for {len(times)} times"
            raise ValueError(f"{field}.T_rig_worlds: {counts}, at least two of each are needed")
        poses = _rigid(f"{field}.T_rig_worlds", rig.T_rig_worlds, checks.WORLD_REACH)
        jump = first_jump(times, poses)
        if jump is not None:
            problem = f"is {jump[1]:.0f} m from the pose before"
            raise ValueError(f"{field}.T_rig_worlds.{jump[0]}: {problem}")
    return Trajectory(times, poses)


def _rigid(field: str, matrices: Sequence[Matrix], reach: float) -> Array:
    """Transforms (N, 4, 4) whose rotations are exactly orthogonal."""
    found = np.array(matrices, np.float64).reshape(-1, 4, 4)
    for index, matrix in enumerate(found):
        checks.check_reach(f"{field}.{index}", matrix[:3, 3], reach)
        checks.check_reach(f"{field}.{index}", matrix[:3, :3], 2.0)
    turned, off = se3.nearest_rotations(found[:, :3, :3])
    wrong = (off > _UNIT) | np.any(found[:, 3] != [0, 0, 0, 1], axis=1)
    if wrong.any():
        raise ValueError(f"{field}.{int(np.argmax(wrong))}: is not a rotation and a translation")
    return se3.from_rotation_translation(turned, found[:, :3, 3])


def _cameras(where: Path, rig: RigTrajectories, wanted: Sequence[str]) -> dict[str, CameraStream]:
    frames = rig.rig_trajectories[0].cameras_frame_timestamps_us
    field = "rig_trajectories.0.cameras_frame_timestamps_us"
    for key, times in frames.items():
        at = np.array(times, np.int64).reshape(-1, 2)
        with refused(where, _MEND):
            if key not in rig.camera_calibrations:
                raise ValueError(f"{field}.{key}: is not in camera_calibrations")
            if np.any(at[:, 1] <= at[:, 0]) or np.any(np.diff(at[:, 1]) <= 0):
                raise ValueError(
                    f"{field}.{key}: frames end before they begin, or are out of order"
                )
    keys: dict[str, str] = {}
    for key in frames:
        name = rig.camera_calibrations[key].logical_sensor_name
        if name in keys:
            at_key = f"camera_calibrations.{key}.logical_sensor_name"
            raise InputError(where, at_key, f"{name!r} appears twice", _MEND)
        keys[name] = key
    if tuple(wanted) == (NO_CAMERA,) and NO_CAMERA not in keys:
        return {}
    chosen = chosen_cameras(where, keys, wanted)
    return {name: _camera(where, name, keys[name], rig.camera_calibrations) for name in chosen}


def _camera(
    where: Path, name: str, key: str, calibrations: dict[str, BundleCamera]
) -> CameraStream:
    field, calibration = f"camera_calibrations.{key}", calibrations[key]
    model, mend = calibration.camera_model, "name the cameras to import, or none, with `cameras`"
    if model.type not in (PINHOLE, "pinhole"):
        problem = f"is {model.type!r}, but logs can only hold {PINHOLE} cameras"
        raise InputError(where, f"{field}.camera_model.type", problem, mend)
    try:
        param = PinholeParameters.model_validate(model.parameters)
    except ValidationError as error:
        fault = validation_error(where, error, _MEND)
        at = f"{field}.camera_model.parameters.{fault.field}"
        raise InputError(where, at, fault.problem, _MEND) from None
    k1, k2, k3, *rest = param.radial_coeffs
    if any((*rest, *param.thin_prism_coeffs)) or param.external_distortion_parameters is not None:
        problem = "has coefficients beyond k1 k2 p1 p2 k3, which logs cannot hold"
        raise InputError(where, f"{field}.camera_model.parameters", problem, mend)
    distortion = (k1, k2, *param.tangential_coeffs, k3)
    camera = PinholeCamera(
        *param.resolution, *param.focal_length, *param.principal_point, distortion
    )
    with refused(where, _MEND):
        try:
            camera.validate()
        except ValueError as error:
            raise ValueError(f"{field}.camera_model.parameters: {error}") from None
        mount = _rigid(f"{field}.T_sensor_rig", [calibration.T_sensor_rig], checks.SENSOR_REACH)
    return CameraStream(name, camera, mount[0], np.zeros(0, np.int64), [])


def _tracks(where: Path, sequence: TrackSequence, ego: Trajectory) -> dict[str, Track]:
    data, sizes = sequence.tracks_data, sequence.cuboidtracks_data.cuboids_dims
    lists = {name: getattr(data, name) for name in type(data).model_fields}
    for name, values in (*lists.items(), ("cuboids_dims", sizes)):
        if len(values) != len(data.tracks_id):
            problem = f"has {len(values)} entries for {len(data.tracks_id)} tracks"
            raise InputError(where, name, problem, _MEND)
    tracks: dict[str, Track] = {}
    for index, key in enumerate(data.tracks_id):
        if key in tracks:
            raise InputError(where, f"tracks_id.{index}", f"{key!r} appears twice", _MEND)
        with refused(where, _MEND):
            trajectory = _trajectory(data, index)
            category = CATEGORIES.get(data.tracks_label_class[index], UNKNOWN)
            track = Track(key, category, np.array(sizes[index]), trajectory)
            track.validate(f"tracks.{index}")
        times = trajectory.timestamps_us
        inside = (times >= ego.timestamps_us[0]) & (times <= ego.timestamps_us[-1])
        if inside.any():
            kept = Trajectory(times[inside], trajectory.poses[inside])
            tracks[key] = Track(key, category, track.size, kept)
    return tracks


def _trajectory(data: TracksData, index: int) -> Trajectory:
    field = f"tracks_poses.{index}"
    times = np.array(data.tracks_timestamps_us[index], np.int64)
    rows = np.array(data.tracks_poses[index], np.float64).reshape(-1, 7)
    if len(rows) != len(times) or not len(times):
        raise ValueError(f"{field}: has {len(rows)} poses for {len(times)} times")
    off = np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0)
    if not np.all(off <= _UNIT):
        wrong = int(np.argmin(off <= _UNIT))
        raise ValueError(f"{field}.{wrong}: the length of its quaternion is not 1")
    rotations = se3.quat_to_matrix(rows[:, [6, 3, 4, 5]])
    return Trajectory(times, se3.from_rotation_translation(rotations, rows[:, :3]))
