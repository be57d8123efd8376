"""Scenes on disk: a folder with scene.json, one PLY a part, and safetensors for the rest."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from torch import Tensor

from recast.errors import InputError
from recast.logs import Trajectory
from recast.records import read_record
from recast.scene.appearance import Appearance
from recast.scene.sky import SkyMap
from recast.scene.street_scene import SceneActor, StreetScene
from recast.scene.tensor_file import read_tensors, write_tensors
from recast.splats import CLASSIC, Gaussians, LowPass, read_ply, write_ply
from recast.storage import write_json

SCENE_VERSION = 1
SCENE_FILE = "scene.json"
TENSOR_FILE = "scene.safetensors"


class ActorRecord(BaseModel):
    """One actor in scene.json."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    track_id: str
    size: tuple[float, float, float]
    gaussians: str
    shadow: str | None = None
    low_pass: LowPass = CLASSIC


class SceneRecord(BaseModel):
    """Contents of scene.json: what the folder holds and where."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    version: int = SCENE_VERSION
    log_name: str
    world_offset: tuple[float, float, float]
    background: str
    tensors: str = TENSOR_FILE
    actors: list[ActorRecord]
    cameras: list[str]


def save_scene(scene: StreetScene, folder: str | Path) -> None:
    """Write a scene into `folder`; scene.json comes last and marks it as complete.

    Raises:
        InputError: the folder holds a scene already, or the disk is full.
    """
    folder = Path(folder)
    if (folder / SCENE_FILE).exists():
        raise InputError(folder, "output folder", "holds a scene already", "name another one")
    write_ply(folder / "background.ply", scene.background)
    tensors: dict[str, Tensor] = {"sky": scene.sky.colours}
    records = []
    for index, (track_id, actor) in enumerate(scene.actors.items()):
        stem = f"actor_{index:03d}_{re.sub(r'[^A-Za-z0-9-]', '_', track_id)}"
        write_ply(folder / f"{stem}.ply", actor.gaussians)
        if actor.shadow is not None:
            write_ply(folder / f"{stem}_shadow.ply", actor.shadow)
        tensors[f"actor/{track_id}/timestamps_us"] = torch.from_numpy(
            actor.trajectory.timestamps_us
        )
        tensors[f"actor/{track_id}/poses"] = torch.from_numpy(actor.trajectory.poses)
        if actor.appearance is not None:
            share = torch.tensor([actor.appearance.frozen_share], dtype=torch.float64)
            tensors[f"actor/{track_id}/waves"] = actor.appearance.waves
            tensors[f"actor/{track_id}/frozen_share"] = share
        records.append(
            ActorRecord(
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
    record = SceneRecord(
        log_name=scene.log_name,
        world_offset=_triple(scene.world_offset),
        background="background.ply",
        actors=records,
        cameras=list(scene.camera_corrections),
    )
    write_json(folder / SCENE_FILE, record.model_dump(mode="json"))


def load_scene(folder: str | Path) -> StreetScene:
    """Read a scene folder.

    Raises:
        InputError: no scene there, of another version, a member missing or broken.
    """
    folder = Path(folder)
    mend = "train the scene anew, or use the release that wrote it"
    record = read_record(folder / SCENE_FILE, SceneRecord, SCENE_VERSION, mend)
    tensors, _ = read_tensors(folder / record.tensors)

    def tensor(name: str) -> Tensor:
        if name not in tensors:
            raise InputError(folder / record.tensors, name, "is missing", "train the scene anew")
        return tensors[name]

    actors = {}
    for entry in record.actors:
        prefix = f"actor/{entry.track_id}"
        actors[entry.track_id] = SceneActor(
            track_id=entry.track_id,
            gaussians=_read_part(folder / entry.gaussians),
            size=np.array(entry.size),
            trajectory=Trajectory(
                tensor(f"{prefix}/timestamps_us").numpy(), tensor(f"{prefix}/poses").numpy()
            ),
            shadow=None if entry.shadow is None else _read_part(folder / entry.shadow),
            appearance=Appearance(
                tensor(f"{prefix}/waves"), float(tensor(f"{prefix}/frozen_share"))
            )
            if f"{prefix}/waves" in tensors
            else None,
            low_pass=entry.low_pass,
        )
    return StreetScene(
        background=_read_part(folder / record.background),
        actors=actors,
        sky=SkyMap(tensor("sky")),
        world_offset=np.array(record.world_offset),
        camera_corrections={
            name: (
                tensor(f"camera/{name}/timestamps_us").numpy(),
                tensor(f"camera/{name}/twists").numpy(),
            )
            for name in record.cameras
        },
        log_name=record.log_name,
    )


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return float(x), float(y), float(z)


def _read_part(path: Path) -> Gaussians:
    if not path.is_file():
        raise InputError(path, "Gaussians", "file is missing", "train the scene anew")
    return read_ply(path)
