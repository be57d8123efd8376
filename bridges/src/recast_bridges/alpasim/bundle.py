"""USDZ packages: ZIP archives whose members are stored as they are, from multiples of 64 bytes on.

Members are never unpacked to the disk: those that are asked for are read into memory.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import struct
import tempfile
import uuid
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from recast import __version__
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.files import atomic_file, disk_errors, member
from recast.dynamics.state import VehicleParameters
from recast.geometry import se3
from recast.logs.checks import check_name, refused
from recast.logs.hdmap import HdMap, map_text
from recast.logs.types import CameraStream, DrivingLog, Track
from recast.scene.street_scene import moves
from recast_bridges.openx import write_opendrive

ALIGNMENT = 64
"""Bytes: the data of each member begins at a multiple."""
_PADDING = 0x1986
"""Id of the extra field of a header that fills the gap, as OpenUSD writes it."""
_HEADER, _FIELD = 30, 4
"""Bytes of a member's header without its name, and of an extra field without its content."""
_FIRST_DAY = (1980, 1, 1, 0, 0, 0)
"""Date of every member, the earliest that ZIP knows: same content, same bytes."""
_UNIX, _READABLE = 3, 0o100644 << 16
_ENCRYPTED = 0x1
_READ = 1 << 20
"""Bytes read at once, at most; so also of an archive's directory: some 10,000 members."""
_DAMAGE = (
    zipfile.BadZipFile,
    NotImplementedError,
    RuntimeError,
    EOFError,
    ValueError,
    struct.error,
    OSError,  # of an offset before the file
)
"""What `zipfile` raises of damaged archives."""
_MEND = "give a bundle that AlpaSim can read: a USDZ file with uncompressed members"


def write_usdz(path: str | Path, members: Mapping[str, bytes]) -> None:
    """Write a package, whole or not at all; the same members give the same bytes.

    Args:
        members: content by plain ASCII names, in their order. OpenUSD opens the first one.

    Raises:
        InputError: the disk refuses.
    """
    at = 0
    with atomic_file(path) as partial, zipfile.ZipFile(partial, "w", allowZip64=False) as archive:
        for name, data in members.items():
            info = zipfile.ZipInfo(name, _FIRST_DAY)
            info.create_system, info.external_attr = _UNIX, _READABLE
            begins = at + _HEADER + len(name) + _FIELD
            padding = -begins % ALIGNMENT
            info.extra = struct.pack("<HH", _PADDING, padding) + bytes(padding)
            archive.writestr(info, data)
            at = begins + padding + len(data)


def read_usdz(path: str | Path, limits: Mapping[str, int]) -> dict[str, bytes]:
    """Those of the named members that are there.

    Args:
        limits: most bytes of a member, by name. Others are not read.

    Raises:
        InputError: missing, no ZIP archive or cut off; a member is compressed, encrypted, larger
            than its limit, there twice, damaged, or has a name that leads out of a folder.
    """
    path = Path(path)
    with disk_errors(path):
        if not path.is_file():
            raise InputError(path, "file", "is missing", "check the path")
        try:
            with _Bounded(path) as file, zipfile.ZipFile(file) as archive:
                _check_members(path, archive.infolist(), limits)
                names = [name for name in limits if name in archive.NameToInfo]
                return {name: _read(archive, name) for name in names}
        except InputError:
            raise
        except _DAMAGE as error:
            if isinstance(error, OSError) and error.errno != errno.EINVAL:  # the disk's own
                raise
            raise InputError(path, "archive", f"cannot be read ({error})", _MEND) from None


class _Bounded(io.FileIO):
    """A file of which little is read at once, whatever an archive says of its own sizes."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > _READ:
            raise zipfile.BadZipFile(f"its directory has {size} bytes, more than {_READ}")
        return super().read(size) or b""


def _read(archive: zipfile.ZipFile, name: str) -> bytes:
    with archive.open(name) as stream:  # gives no more bytes than the directory says
        return b"".join(iter(lambda: stream.read(_READ), b""))


def _check_members(path: Path, infos: list[zipfile.ZipInfo], limits: Mapping[str, int]) -> None:
    seen = set()
    for info in infos:
        name = info.filename
        # `orig_filename` has what `filename` was cut off at: a NUL and what follows it.
        member(path, info.orig_filename.rstrip("/") or "/", path, "member")
        field = f"member {name}"
        if name in seen:
            raise InputError(path, field, "appears twice", _MEND)
        seen.add(name)
        if info.flag_bits & _ENCRYPTED:
            raise InputError(path, field, "is encrypted", _MEND)
        if info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
            raise InputError(path, field, "is compressed", _MEND)
        if info.file_size > limits.get(name, info.file_size):
            problem = f"has {info.file_size} bytes, more than {limits[name]}"
            raise InputError(path, field, problem, _MEND)


# Scene bundles of AlpaSim: what its runtime reads of a log, as one USDZ package.
#
# The local frame is the log's world, the rig frame is recast's. AlpaSim's `T_target_source` names
# are the wrong way round for recast: `T_rig_worlds` are `world_from_rig`, `T_sensor_rig` is
# `rig_from_sensor`. Names of the log are text in JSON and YAML; none becomes a member or a path.

SUFFIX = ".usdz"
LAYER, METADATA = "default.usda", "metadata.yaml"
RIG, TRACKS = "rig_trajectories.json", "sequence_tracks.json"
ROADS, MAP = "map.xodr", "recast_map.json"
"""Members of a bundle: the map for the runtime, and the map that recast reads back."""
PINHOLE = "opencv-pinhole"
"""Camera models have NCore's names and parameters."""
LABELS = {
    "car": "automobile",
    "van": "automobile",
    "truck": "heavy_truck",
    "bus": "bus",
    "pedestrian": "person",
    "trailer": "trailer",
    "cyclist": "bicycle",
    "motorcyclist": "rider",
    "tram": "train_or_tram_car",
}
"""AlpaSim's label classes by category; all others are `OTHER`."""
OTHER = "other_vehicle"
MOVING, STANDING = "DYNAMIC|CONTROLLABLE", "NONE"
"""Flags of tracks: the runtime tells a renderer where the first kind is, and none of the others."""
EGO_HEIGHT = 1.777
"""Metres, of nuPlan's Chrysler Pacifica, whose other sizes `VehicleParameters` has."""

_LAYER = b'#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = "Z"\n)\n'
"""OpenUSD wants a layer as the first member; this one holds nothing."""


@dataclass(frozen=True)
class ExportedBundle:
    """What `export_bundle` wrote.

    Attributes:
        scene_id: scene id by which the runtime asks the renderer.
        cameras: number of cameras.
        tracks: number of tracks.
        lanes: number of lanes.
        frames_left_out: camera frames that begin before the ego trajectory.
        tracks_left_out: tracks with one label, through which the runtime can lay no spline.
    """

    scene_id: str
    cameras: int
    tracks: int
    lanes: int
    frames_left_out: int
    tracks_left_out: int


def export_bundle(
    log: DrivingLog,
    path: str | Path,
    scene_id: str | None = None,
    *,
    with_map: bool = True,
    vehicle: VehicleParameters | None = None,
) -> ExportedBundle:
    """Write a log as a bundle; the same log gives the same bytes.

    Args:
        log: its images and sweeps are not read.
        path: file to write, NAME.usdz; must not exist.
        scene_id: the scene's id at the renderer; None takes the log's name.
        with_map: whether to write the log's map.
        vehicle: sizes of the ego; None takes the defaults.

    Raises:
        InputError: `path` exists or is called otherwise, the log or id is not valid, or the disk
            refuses.
    """
    path, vehicle = Path(path), vehicle or VehicleParameters()
    if path.suffix != SUFFIX:
        problem = f"does not end in {SUFFIX}"
        mend = f"end the name in {SUFFIX}, or AlpaSim's runtime does not find the bundle"
        raise InputError(path, "file name", problem, mend)
    if path.exists():
        raise InputError(
            path, "output file", "exists already", "name another file or remove this one"
        )
    scene = log.name if scene_id is None else scene_id
    with refused(f"log {log.name}", "correct the data from which the log was made"):
        log.validate()
    with refused("`scene`", "give another id"):
        check_name("scene id", scene)
    tracks = [one for one in log.tracks.values() if len(one.trajectory.timestamps_us) > 1]
    hdmap = log.map if with_map else None
    rig, left_out = _rig(log, scene, vehicle)
    content = {RIG: _json(rig), TRACKS: _json({scene: _tracks(tracks)})}
    if hdmap is not None:
        content |= {ROADS: _roads(hdmap, scene), MAP: map_text(hdmap).encode()}
    metadata = _metadata(log, scene, content)
    write_usdz(path, {LAYER: _LAYER, METADATA: metadata, **content})
    return ExportedBundle(
        scene_id=scene,
        cameras=len(log.cameras),
        tracks=len(tracks),
        lanes=0 if hdmap is None else len(hdmap.lanes),
        frames_left_out=left_out,
        tracks_left_out=len(log.tracks) - len(tracks),
    )


def _json(value: Any) -> bytes:
    """JSON in ASCII; floats keep every digit."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()


class _Dumper(yaml.SafeDumper):
    """Quotes all text but letters and _: readers differ in what they take for a number (1e3)."""


_Dumper.add_representer(
    str,
    lambda dumper, text: dumper.represent_scalar(
        "tag:yaml.org,2002:str", text, style=None if text.replace("_", "").isalpha() else '"'
    ),
)


def _metadata(log: DrivingLog, scene: str, content: dict[str, bytes]) -> bytes:
    """metadata.yaml; what AlpaSim takes from a training run follows from the log."""
    digest = hashlib.blake2b(digest_size=16)
    for data in content.values():
        digest.update(len(data).to_bytes(8, "little") + data)
    first, last = (float(time) for time in log.world_from_rig.timestamps_us[[0, -1]])
    record = {
        "scene_id": scene,
        "version_string": f"recast-{__version__}",
        "training_date": datetime.fromtimestamp(first / 1e6, UTC).date().isoformat(),
        "dataset_hash": digest.hexdigest(),
        "uuid": str(uuid.UUID(bytes=digest.digest(), version=4)),
        "is_resumable": False,
        "sensors": {"camera_ids": list(log.cameras), "lidar_ids": []},
        "logger": {"name": "recast", "run_id": None, "run_url": None},
        "time_range": {"start": first, "end": last},
    }
    return yaml.dump(record, Dumper=_Dumper, sort_keys=False).encode()


def _rig(log: DrivingLog, scene: str, vehicle: VehicleParameters) -> tuple[dict[str, Any], int]:
    """rig_trajectories.json, and the number of frames that were left out."""
    keys = {name: f"{name}@{scene}" for name in log.cameras}
    frames = {keys[name]: _frames(stream, log) for name, stream in log.cameras.items()}
    asked = sum(len(stream.timestamps_us) for stream in log.cameras.values())
    identity = np.eye(4).tolist()
    centre = [vehicle.centre_offset, 0.0, EGO_HEIGHT / 2]
    size = [vehicle.length, vehicle.width, EGO_HEIGHT]
    record = {
        # The roads have no geoReference, so the runtime turns them by the identity.
        "T_world_base": identity,
        "world_to_nre": {"matrix": identity},
        "camera_calibrations": {
            keys[name]: {
                "sequence_id": scene,
                "logical_sensor_name": name,
                "unique_sensor_idx": index,
                "T_sensor_rig": stream.rig_from_camera.tolist(),
                "camera_model": {"type": PINHOLE, "parameters": _parameters(stream.camera)},
            }
            for index, (name, stream) in enumerate(log.cameras.items())
        },
        "lidar_calibrations": {},
        "rig_trajectories": [
            {
                "sequence_id": scene,
                "T_rig_world_timestamps_us": log.world_from_rig.timestamps_us.tolist(),
                "T_rig_worlds": log.world_from_rig.poses.tolist(),
                "cameras_frame_timestamps_us": frames,
                "lidars_frame_timestamps_us": {},
                "rig_bbox": {"centroid": centre, "dim": size, "rot": [0.0, 0.0, 0.0]},
            }
        ],
    }
    return record, asked - sum(map(len, frames.values()))


def _frames(stream: CameraStream, log: DrivingLog) -> list[list[int]]:
    """Begin and end of each frame: a frame of no length is none in AlpaSim, so each begins a
    microsecond before its time. The runtime needs the ego's pose at both."""
    first = int(log.world_from_rig.timestamps_us[0])
    return [[time - 1, time] for time in stream.timestamps_us.tolist() if time > first]


def _parameters(camera: PinholeCamera) -> dict[str, Any]:
    k1, k2, p1, p2, k3 = camera.distortion
    return {
        "resolution": [camera.width, camera.height],
        "shutter_type": "GLOBAL",
        "external_distortion_parameters": None,
        "principal_point": [camera.cx, camera.cy],
        "focal_length": [camera.fx, camera.fy],
        "radial_coeffs": [k1, k2, k3, 0.0, 0.0, 0.0],
        "tangential_coeffs": [p1, p2],
        "thin_prism_coeffs": [0.0, 0.0, 0.0, 0.0],
    }


def _tracks(tracks: list[Track]) -> dict[str, Any]:
    """The one sequence of sequence_tracks.json; poses are x y z and a quaternion x y z w."""
    poses = []
    for track in tracks:
        matrices = track.trajectory.poses
        wxyz = se3.matrix_to_quat(matrices[:, :3, :3])
        poses.append(np.hstack([matrices[:, :3, 3], wxyz[:, [1, 2, 3, 0]]]).tolist())
    return {
        "tracks_data": {
            "tracks_id": [track.track_id for track in tracks],
            "tracks_label_class": [LABELS.get(track.category, OTHER) for track in tracks],
            "tracks_flags": [MOVING if moves(track.trajectory) else STANDING for track in tracks],
            "tracks_timestamps_us": [track.trajectory.timestamps_us.tolist() for track in tracks],
            "tracks_poses": poses,
        },
        "cuboidtracks_data": {"cuboids_dims": [track.size.tolist() for track in tracks]},
    }


def _roads(hdmap: HdMap, name: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / ROADS
        write_opendrive(path, hdmap, name)
        return path.read_bytes()
