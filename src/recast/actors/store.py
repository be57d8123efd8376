"""Actors on disk: a folder with actor.json, two PLY files, tensors and the source image."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from recast import storage
from recast.actors.actor import Actor, Provenance
from recast.errors import InputError
from recast.records import read_record
from recast.splats import Gaussians, LowPass, read_ply, write_ply

ACTOR_VERSION = 2
ACTOR_FILE = "actor.json"
VEHICLE_FILE = "vehicle.ply"
SHADOW_FILE = "shadow.safetensors"
SOURCE_FILE = "source.png"

_FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")


class ActorRecord(BaseModel):
    """Contents of actor.json."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    version: int
    track_id: str
    category: str
    size: tuple[float, float, float]
    provenance: Provenance
    low_pass: LowPass


def save_actor(actor: Actor, folder: str | Path) -> None:
    """Write an actor to the new folder `folder`; it appears whole or not at all.

    Raises:
        ValueError: the actor is not valid.
        InputError: the folder exists, or the disk is full.
    """
    actor.validate()
    length, width, height = (float(v) for v in actor.size)
    record = ActorRecord(
        version=ACTOR_VERSION,
        track_id=actor.track_id,
        category=actor.category,
        size=(length, width, height),
        provenance=actor.provenance,
        low_pass=actor.low_pass,
    )
    with storage.atomic_folder(folder) as partial:
        write_ply(partial / VEHICLE_FILE, actor.gaussians, actor.low_pass)
        shadow = {name: getattr(actor.shadow, name).contiguous() for name in _FIELDS}
        save_file(shadow, str(partial / SHADOW_FILE))
        bgra = cv2.cvtColor(actor.source, cv2.COLOR_RGBA2BGRA)
        storage.write_bytes(partial / SOURCE_FILE, cv2.imencode(".png", bgra)[1].tobytes())
        storage.write_json(partial / ACTOR_FILE, record.model_dump(mode="json"))


def load_actor(folder: str | Path) -> Actor:
    """Read an actor folder.

    Raises:
        InputError: no such folder, another version, or a file of it missing or broken.
    """
    folder = Path(folder)
    mend = "generate the actor again with this recast"
    record = read_record(folder / ACTOR_FILE, ActorRecord, ACTOR_VERSION, mend)
    return Actor(
        track_id=record.track_id,
        category=record.category,
        size=np.array(record.size),
        gaussians=read_ply(folder / VEHICLE_FILE),
        shadow=_read_shadow(folder / SHADOW_FILE),
        provenance=record.provenance,
        source=_read_source(folder / SOURCE_FILE),
        low_pass=record.low_pass,
    )


def _read_shadow(path: Path) -> Gaussians:
    try:
        tensors = load_file(str(path))
        shadow = Gaussians(**{name: tensors[name] for name in _FIELDS})
        shadow.validate()
    except (FileNotFoundError, SafetensorError, KeyError, ValueError, OSError) as error:
        raise InputError(
            path, "tensors", f"cannot be read ({error})", "generate the actor again"
        ) from None
    return shadow


def _read_source(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 3 or image.shape[2] != 4:
        raise InputError(path, "image", "is missing or no RGBA PNG", "generate the actor again")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGRA2RGBA), np.uint8)
