"""Scenes on disk: a folder with scene.json, one PLY a part, and safetensors for the rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.core.errors import InputError
from recast.core.files import write_json
from recast.core.names import folder_name, member
from recast.core.records import Record, read_record
from recast.logs import Trajectory
from recast.scene.appearance import Appearance
from recast.scene.bodies import Skinning
from recast.scene.deformation import Deformation
from recast.scene.sky import SkyMap
from recast.scene.street_scene import Deforming, SceneActor, StreetScene
from recast.scene.tensor_file import (
    BODIES_FILE,
    DEFORMATION_FILE,
    read_bodies_file,
    read_deformations,
    read_tensors,
    write_bodies,
    write_deformations,
    write_tensors,
)
from recast.splats import CLASSIC, Gaussians, LowPass, read_ply, write_ply

SCENE_VERSION = 1
SCENE_FILE = "scene.json"
TENSOR_FILE = "scene.safetensors"
_MEND = "train the scene again, or use the release that wrote it"


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
    tensors: str = TENSOR_FILE
    actors: list[SceneActorRecord]
    cameras: list[str]
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
    write_ply(folder / "background.ply", scene.background)
    tensors: dict[str, Tensor] = {"sky": scene.sky.colours}
    records = []
    for index, (track_id, actor) in enumerate(scene.actors.items()):
        stem = f"actor_{index:03d}_{folder_name(track_id)}"
        write_ply(folder / f"{stem}.ply", actor.gaussians)
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
        actors=records,
        cameras=list(scene.camera_corrections),
        deformation=DEFORMATION_FILE if deformations else None,
        bodies=BODIES_FILE if bodies else None,
    )
    values = record.model_dump(mode="json")
    # What no actor has is not mentioned: earlier releases read it then.
    for name in ("deformation", "bodies"):
        if values[name] is None:
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
        log_name=record.log_name,
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
