"""Scenes on disk: a folder with scene.json, one PLY a part, and safetensors for the rest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from safetensors.torch import save
from torch import Tensor

from recast.core.errors import InputError
from recast.core.files import folder_name, member, parse_json, write_bytes, write_json
from recast.core.records import Record, read_record
from recast.core.torch_file import read_safetensors
from recast.logs import DrivingLog, Trajectory
from recast.scene.actor import Appearance, Deforming, SceneActor
from recast.scene.deformation import MOST_LAYERS, Deformation, DeformationNetwork, Skinning
from recast.scene.sky import SkyMap
from recast.scene.street_scene import StreetScene
from recast.splats import CLASSIC, Gaussians, LowPass, read_ply, write_ply

HEADER = "recast"
DEFORMATION_FILE = "deformation.safetensors"
DEFORMATION_VERSION = 1
BODIES_FILE = "bodies.safetensors"
BODIES_VERSION = 1
_BODY_TYPES = {
    "weights": torch.float32,
    "joints": torch.float64,
    "parents": torch.int64,
    "timestamps_us": torch.int64,
    "rotations": torch.float64,
    "translations": torch.float64,
}
SCENE_VERSION = 1
SCENE_FILE = "scene.json"
TENSOR_FILE = "scene.safetensors"
_MARKS = ("unseen", "sky_seen")
_MEND = "train the scene again, or use the release that wrote it"


def write_tensors(path: Path, tensors: Mapping[str, Tensor], header: Mapping[str, Any]) -> None:
    """Write tensors and header atomically; InputError if the disk refuses."""
    plain: dict[str, Tensor] = {}
    held: set[int] = set()
    for name, tensor in tensors.items():
        # The format takes no two tensors of one memory: such are copied, the large ones are none.
        one = tensor.detach().cpu().contiguous()
        start = one.untyped_storage().data_ptr()
        plain[name] = one.clone() if start in held else one
        held.add(start)
    write_bytes(path, save(plain, metadata={HEADER: json.dumps(header)}))


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and header of a file; InputError if missing, cut short, or not ours."""
    tensors, texts = read_safetensors(path, "tensors", "write it again")
    header = parse_json(path, texts.get(HEADER, ""))
    if not isinstance(header, dict):
        raise InputError(path, "header", "is not an object", "write it again")
    return tensors, header


def write_deformations(path: Path, deformations: Mapping[str, Deformation]) -> None:
    """Write the deformations of a scene's actors, by track id.

    Raises:
        ValueError: they do not share one network.
        InputError: the disk refuses.
    """
    network = next(iter(deformations.values())).network
    tensors: dict[str, Tensor] = {f"layer/{k}": layer for k, layer in enumerate(network.layers)}
    for track_id, own in deformations.items():
        if own.network is not network:
            raise ValueError(f"actors[{track_id!r}].deformation: has a network of its own")
        tensors[f"code/{track_id}"] = own.code
        tensors[f"reach/{track_id}"] = torch.tensor([own.reach], dtype=torch.float64)
    header = {
        "version": DEFORMATION_VERSION,
        "layers": len(network.layers),
        "bands": network.bands,
        "time_bands": network.time_bands,
        "actors": list(deformations),
    }
    write_tensors(path, tensors, header)


def read_deformations(path: Path, mend: str) -> dict[str, Deformation]:
    """Read `write_deformations`'s file.

    Raises:
        InputError: missing, damaged, of another version, or with a tensor that is missing, of
            another shape or kind, or has values that no network has.
    """
    tensors, header = read_tensors(path)
    names = _names(path, header, DEFORMATION_VERSION, mend)
    counts = [header.get(name) for name in ("layers", "bands", "time_bands")]
    if not all(type(count) is int and count >= 0 for count in counts):
        raise InputError(path, "header", "names no layers or bands", mend)
    layers, bands, time_bands = (int(count) for count in counts if count is not None)
    wanted = {f"layer/{k}" for k in range(min(layers, MOST_LAYERS + 2))}
    _require(path, tensors, wanted | _of(names, ("code", "reach")), mend)
    network = DeformationNetwork(
        tuple(tensors[f"layer/{k}"] for k in range(len(wanted))), bands, time_bands
    )
    fault = network.fault()
    if fault is not None:
        raise InputError(path, "network", fault, mend)
    found: dict[str, Deformation] = {}
    for name in names:
        code, reach = tensors[f"code/{name}"], tensors[f"reach/{name}"]
        if code.dtype != torch.float32 or reach.dtype != torch.float64 or reach.numel() != 1:
            raise InputError(path, f"code/{name}", "or its reach is of another kind", mend)
        own = Deformation(network, code, float(reach))
        try:
            own.validate(name, 0)
        except ValueError as error:
            raise InputError(path, "actors", str(error), mend) from None
        found[name] = own
    return found


def write_bodies(path: Path, bodies: Mapping[str, Skinning]) -> None:
    """Write the skinnings of a scene's bodies, by track id; InputError if the disk refuses."""
    tensors = {
        f"{part}/{track_id}": torch.as_tensor(getattr(body, part))
        for track_id, body in bodies.items()
        for part in _BODY_TYPES
    }
    write_tensors(path, tensors, {"version": BODIES_VERSION, "actors": list(bodies)})


def read_bodies_file(path: Path, mend: str) -> dict[str, Skinning]:
    """Read `write_bodies`'s file; the scene that it belongs to checks shapes and values.

    Raises:
        InputError: missing, damaged, of another version, or with a tensor that is missing or of
            another kind.
    """
    tensors, header = read_tensors(path)
    names = _names(path, header, BODIES_VERSION, mend)
    _require(path, tensors, _of(names, tuple(_BODY_TYPES)), mend)
    for name, tensor in tensors.items():
        wanted = _BODY_TYPES[name.partition("/")[0]]
        if tensor.dtype != wanted:
            raise InputError(path, name, f"is of {tensor.dtype}, not {wanted}", mend)
    return {
        name: Skinning(
            tensors[f"weights/{name}"],
            *(tensors[f"{part}/{name}"].numpy() for part in tuple(_BODY_TYPES)[1:]),
        )
        for name in names
    }


def _names(path: Path, header: Mapping[str, Any], version: int, mend: str) -> list[str]:
    """Track ids in a header of this version."""
    if header.get("version") != version:
        problem = f"is {header.get('version')!r}, this recast reads {version}"
        raise InputError(path, "version", problem, mend)
    names = header.get("actors")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise InputError(path, "header", "names no actors", mend)
    return names


def _of(names: list[str], parts: tuple[str, ...]) -> set[str]:
    return {f"{part}/{name}" for name in names for part in parts}


def _require(path: Path, tensors: Mapping[str, Tensor], wanted: set[str], mend: str) -> None:
    """Raise InputError unless there are just these tensors."""
    wrong = sorted(tensors.keys() ^ wanted)
    if wrong:
        problem = "is not expected" if wrong[0] in tensors else "is missing"
        raise InputError(path, wrong[0], problem, mend)


class SceneActorRecord(Record):
    """One actor in scene.json."""

    track_id: str
    size: tuple[float, float, float]
    gaussians: str
    shadow: str | None = None
    low_pass: LowPass = CLASSIC


class SceneRecord(Record):
    """Contents of scene.json: what the folder holds and where."""

    version: int = SCENE_VERSION
    log_name: str
    world_offset: tuple[float, float, float]
    background: str
    low_pass: LowPass = CLASSIC
    tensors: str = TENSOR_FILE
    actors: list[SceneActorRecord]
    cameras: list[str]
    exposures: list[str] = Field(default_factory=list)
    mounts: list[str] = Field(default_factory=list)
    deformation: str | None = None
    bodies: str | None = None


def save_scene(scene: StreetScene, folder: str | Path) -> None:
    """Write a scene into `folder`; scene.json comes last and marks it as complete.

    Raises:
        ValueError: the scene is not valid.
        InputError: the folder already holds a scene, or the disk refuses.
    """
    scene.validate()
    folder = Path(folder)
    if (folder / SCENE_FILE).exists():
        raise InputError(folder, "output folder", "already holds a scene", "name another one")
    write_ply(folder / "background.ply", scene.background, scene.low_pass)
    tensors: dict[str, Tensor] = {"sky": scene.sky.colours}
    records = []
    for index, (track_id, actor) in enumerate(scene.actors.items()):
        stem = f"actor_{index:03d}_{folder_name(track_id)}"
        write_ply(folder / f"{stem}.ply", actor.gaussians, actor.low_pass)
        if actor.shadow is not None:
            write_ply(folder / f"{stem}_shadow.ply", actor.shadow)
        trajectory = actor.trajectory
        tensors[f"actor/{track_id}/timestamps_us"] = torch.from_numpy(trajectory.timestamps_us)
        tensors[f"actor/{track_id}/poses"] = torch.from_numpy(trajectory.poses)
        if actor.appearance is not None:
            share = torch.tensor([actor.appearance.frozen_share], dtype=torch.float64)
            tensors[f"actor/{track_id}/waves"] = actor.appearance.fourier
            tensors[f"actor/{track_id}/frozen_share"] = share
        records.append(
            SceneActorRecord(
                track_id=track_id,
                size=_triple(actor.size),
                gaussians=f"{stem}.ply",
                shadow=None if actor.shadow is None else f"{stem}_shadow.ply",
                low_pass=actor.low_pass,
            )
        )
    for name, (times, twists) in scene.camera_corrections.items():
        tensors[f"camera/{name}/timestamps_us"] = torch.from_numpy(times)
        tensors[f"camera/{name}/twists"] = torch.from_numpy(twists)
    for name, (times, affines) in scene.exposures.items():
        tensors[f"exposure/{name}/timestamps_us"] = torch.from_numpy(times)
        tensors[f"exposure/{name}/affines"] = torch.from_numpy(affines)
    tensors |= {f"mount/{name}": torch.from_numpy(moved) for name, moved in scene.mounts.items()}
    marks = {name: getattr(scene, name) for name in _MARKS}
    tensors |= {name: mark for name, mark in marks.items() if mark is not None}
    write_tensors(folder / TENSOR_FILE, tensors, {"version": SCENE_VERSION})
    shaped = {track_id: actor.deformation for track_id, actor in scene.actors.items()}
    deformations = {k: v for k, v in shaped.items() if isinstance(v, Deformation)}
    bodies = {k: v for k, v in shaped.items() if isinstance(v, Skinning)}
    if deformations:
        write_deformations(folder / DEFORMATION_FILE, deformations)
    if bodies:
        write_bodies(folder / BODIES_FILE, bodies)
    record = SceneRecord(
        log_name=scene.log_name,
        world_offset=_triple(scene.world_offset),
        background="background.ply",
        low_pass=scene.low_pass,
        actors=records,
        cameras=list(scene.camera_corrections),
        exposures=list(scene.exposures),
        mounts=list(scene.mounts),
        deformation=DEFORMATION_FILE if deformations else None,
        bodies=BODIES_FILE if bodies else None,
    )
    values = record.model_dump(mode="json")
    # What a scene has not is not mentioned: earlier releases read it then.
    for name in ("deformation", "bodies", "exposures", "mounts"):
        if not values[name]:
            del values[name]
    write_json(folder / SCENE_FILE, values)


def load_scene(folder: str | Path) -> StreetScene:
    """Read a scene folder.

    Raises:
        InputError: no scene there, of another version, a member missing, broken, outside of the
            folder, or with values that no scene has.
    """
    folder = Path(folder)
    path = folder / SCENE_FILE
    record = read_record(path, SceneRecord, SCENE_VERSION, _MEND)
    if len({entry.track_id for entry in record.actors}) < len(record.actors):
        raise InputError(path, "actors", "name a track twice", _MEND)
    tensors = _Tensors(member(folder, record.tensors, path, "tensors"))
    shapes = _read_shapes(folder, record)
    scene = StreetScene(
        background=_read_part(folder, record.background, "background"),
        actors={
            entry.track_id: replace(
                _read_actor(folder, entry, tensors), deformation=shapes.get(entry.track_id)
            )
            for entry in record.actors
        },
        sky=SkyMap(tensors.get("sky", torch.float32)),
        world_offset=np.array(record.world_offset),
        camera_corrections={
            name: (
                tensors.get(f"camera/{name}/timestamps_us", torch.int64).numpy(),
                tensors.get(f"camera/{name}/twists", torch.float64).numpy(),
            )
            for name in record.cameras
        },
        exposures={
            name: (
                tensors.get(f"exposure/{name}/timestamps_us", torch.int64).numpy(),
                tensors.get(f"exposure/{name}/affines", torch.float64).numpy(),
            )
            for name in record.exposures
        },
        mounts={
            name: tensors.get(f"mount/{name}", torch.float64).numpy() for name in record.mounts
        },
        **{name: tensors.get(name, torch.bool) for name in _MARKS if name in tensors},
        log_name=record.log_name,
        low_pass=record.low_pass,
    )
    try:
        scene.validate()
    except ValueError as error:
        raise InputError(folder, "scene", str(error), _MEND) from None
    object.__setattr__(scene, "origin", folder.absolute())
    return scene


def _read_shapes(folder: Path, record: SceneRecord) -> dict[str, Deforming]:
    """What changes the actors' shapes, by track id."""
    left = {entry.track_id for entry in record.actors}
    found: dict[str, Deforming] = {}
    files: tuple[tuple[str, str | None, Callable[[Path, str], Mapping[str, Deforming]]], ...] = (
        ("deformation", record.deformation, read_deformations),
        ("bodies", record.bodies, read_bodies_file),
    )
    for field, name, read in files:
        if name is None:
            continue
        path = member(folder, name, folder / SCENE_FILE, field)
        shapes = read(path, _MEND)
        strangers = sorted(shapes.keys() - left)
        if strangers:
            problem = f"names track {strangers[0]}, which the scene lacks, or which has two shapes"
            raise InputError(path, "actors", problem, _MEND)
        left -= shapes.keys()
        found |= shapes
    return found


class _Tensors:
    """The tensors of a scene by name; what is missing or of another type is an InputError."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found, _ = read_tensors(path)

    def __contains__(self, name: str) -> bool:
        return name in self._found

    def get(self, name: str, dtype: torch.dtype) -> Tensor:
        if name not in self._found:
            raise InputError(self._path, name, "is missing", _MEND)
        found = self._found[name]
        if found.dtype != dtype:
            raise InputError(self._path, name, f"is of {found.dtype}, not {dtype}", _MEND)
        return found


def _read_actor(folder: Path, entry: SceneActorRecord, tensors: _Tensors) -> SceneActor:
    prefix = f"actor/{entry.track_id}"
    gaussians = _read_part(folder, entry.gaussians, "actors.gaussians")
    appearance = None
    if f"{prefix}/waves" in tensors:
        share = tensors.get(f"{prefix}/frozen_share", torch.float64)
        if share.numel() != 1:
            raise InputError(folder, f"{prefix}/frozen_share", "is not one number", _MEND)
        appearance = Appearance(tensors.get(f"{prefix}/waves", torch.float32), float(share))
    return SceneActor(
        track_id=entry.track_id,
        gaussians=gaussians,
        size=np.array(entry.size),
        trajectory=Trajectory(
            tensors.get(f"{prefix}/timestamps_us", torch.int64).numpy(),
            tensors.get(f"{prefix}/poses", torch.float64).numpy(),
        ),
        shadow=None if entry.shadow is None else _read_part(folder, entry.shadow, "actors.shadow"),
        appearance=appearance,
        low_pass=entry.low_pass,
    )


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return float(x), float(y), float(z)


def _read_part(folder: Path, name: str, field: str) -> Gaussians:
    return read_ply(member(folder, name, folder / SCENE_FILE, field))


def log_fingerprint(log: DrivingLog) -> str:
    """SHA-256 over everything of a log but images and points, in hexadecimal.

    Times, poses, intrinsics and boxes tell drives and imports apart; hashing all pixels would take
    longer than starting over.
    """
    digest = hashlib.sha256(log.name.encode())

    def add(name: str, *arrays: object) -> None:
        digest.update(name.encode())
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())

    add("ego", log.world_from_rig.timestamps_us, log.world_from_rig.poses, log.world_offset)
    for name, camera in log.cameras.items():
        intrinsics = camera.camera
        add(name, camera.timestamps_us, camera.rig_from_camera, intrinsics.matrix)
        add("image", [intrinsics.width, intrinsics.height], intrinsics.distortion)
    for name, lidar in log.lidars.items():
        add(name, lidar.timestamps_us, lidar.rig_from_lidar)
    for name, track in log.tracks.items():
        add(name, track.size, track.trajectory.timestamps_us, track.trajectory.poses)
    return digest.hexdigest()
