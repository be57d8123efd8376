"""The members of AlpaSim's scene bundles as its runtime reads them; all others are left alone."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from recast.logs import checks
from recast.logs.importers.common import ForeignRecord

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
