"""Vehicles in files: actors' folders, and files of Gaussians or meshes in place of a generator.

The folder of an actor holds actor.json, a PLY file, tensors and the source image.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import save

from recast.actors.actor import Actor, Provenance, triple
from recast.actors.axes import AUTO, VEHICLE
from recast.actors.coverage import Shares
from recast.actors.generate import ActorGenerator, Asset, BaseGenerator
from recast.actors.mesh import MESH_SUFFIXES, MeshGenerator, files_of_mesh
from recast.actors.observation import Observation
from recast.actors.splat_files import SplatGenerator, holds_gaussians
from recast.core import files
from recast.core.arguments import checked
from recast.core.errors import InputError
from recast.core.images import decode_image
from recast.core.plugins import GENERATORS
from recast.core.records import Record, read_record
from recast.core.torch_file import read_safetensors
from recast.logs import Trajectory
from recast.logs.images import encode
from recast.splats import Gaussians, LowPass, read_ply, write_ply

ACTOR_VERSION = 2
ACTOR_FILE = "actor.json"
VEHICLE_FILE = "vehicle.ply"
SHADOW_FILE = "shadow.safetensors"
SOURCE_FILE = "source.png"
REFINED_FILE = "refined.safetensors"

SOURCE_PIXELS = 1 << 26
"""Pixels of a source image, at most: a crop of a camera's image has far fewer."""

_MEND = "generate the actor again with this version of recast"
_FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")
VEHICLE_SUFFIXES = tuple(dict.fromkeys((".ply", *MESH_SUFFIXES, *sorted(GENERATORS.files))))
"""Ends of the names of files that hold a vehicle, in lower case."""


class ActorRecord(Record):
    """Contents of actor.json."""

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
        InputError: the folder exists, or the disk refuses.
    """
    actor.validate()
    record = ActorRecord(
        version=ACTOR_VERSION,
        track_id=actor.track_id,
        category=actor.category,
        size=triple(actor.size),
        provenance=actor.provenance,
        low_pass=actor.low_pass,
    )
    with files.atomic_folder(folder) as partial:
        write_ply(partial / VEHICLE_FILE, actor.gaussians, actor.low_pass)
        shadow = {name: getattr(actor.shadow, name).contiguous() for name in _FIELDS}
        files.write_bytes(partial / SHADOW_FILE, save(shadow))
        if actor.shares is not None:
            files.write_bytes(partial / REFINED_FILE, save(_refined(actor)))
        files.write_bytes(partial / SOURCE_FILE, encode(actor.source))
        files.write_json(partial / ACTOR_FILE, record.model_dump(mode="json"))


@checked()
def load_actor(folder: str | Path) -> Actor:
    """Read an actor folder.

    Raises:
        InputError: no such folder, another version, a file of it missing or broken, or values that
            no actor has.
    """
    folder = Path(folder)
    record = read_record(folder / ACTOR_FILE, ActorRecord, ACTOR_VERSION, _MEND)
    shares, trajectory, sun = None, None, None
    refinement = record.provenance.refinement
    if refinement is not None and refinement.kept:
        shares, trajectory, sun = _read_refined(folder / REFINED_FILE)
    actor = Actor(
        track_id=record.track_id,
        category=record.category,
        size=np.array(record.size),
        gaussians=read_ply(folder / VEHICLE_FILE),
        shadow=_read_shadow(folder / SHADOW_FILE),
        provenance=record.provenance,
        source=_read_source(folder / SOURCE_FILE),
        low_pass=record.low_pass,
        shares=shares,
        trajectory=trajectory,
        sun=sun,
    )
    try:
        actor.validate()
    except ValueError as error:
        raise InputError(folder, "actor", str(error), _MEND) from None
    return actor


def _tensors(path: Path, names: Iterable[str]) -> dict[str, torch.Tensor]:
    tensors, _ = read_safetensors(path, "tensors", _MEND)
    for name in names:
        if name not in tensors:
            raise InputError(path, name, "is missing", _MEND)
    return tensors


def _read_shadow(path: Path) -> Gaussians:
    tensors = _tensors(path, _FIELDS)
    shadow = Gaussians(**{name: tensors[name] for name in _FIELDS})
    fault = shadow.fault()
    if fault is not None:
        raise InputError(path, *fault, _MEND)
    return shadow


def _refined(actor: Actor) -> dict[str, torch.Tensor]:
    """What refinement adds to an actor, by name."""
    assert actor.shares is not None and actor.trajectory is not None and actor.sun is not None
    return {
        "seen": actor.shares.seen.contiguous(),
        "mirrored": actor.shares.mirrored.contiguous(),
        "timestamps_us": torch.from_numpy(actor.trajectory.timestamps_us).contiguous(),
        "poses": torch.from_numpy(actor.trajectory.poses).contiguous(),
        "sun": torch.from_numpy(actor.sun).contiguous(),
    }


def _read_refined(path: Path) -> tuple[Shares, Trajectory, NDArray[np.float64]]:
    types = dict.fromkeys(("seen", "mirrored"), torch.float32)
    types |= {"timestamps_us": torch.int64, "poses": torch.float64, "sun": torch.float64}
    tensors = _tensors(path, types)
    for name, kind in types.items():
        if tensors[name].dtype != kind:
            raise InputError(path, name, f"is {tensors[name].dtype}, not {kind}", _MEND)
    times, poses = tensors["timestamps_us"].numpy(), tensors["poses"].numpy()
    if times.ndim != 1:
        raise InputError(path, "timestamps_us", f"has shape {times.shape}", _MEND)
    shares = Shares(tensors["seen"], tensors["mirrored"])
    return shares, Trajectory(times, poses), tensors["sun"].numpy()


def _read_source(path: Path) -> np.ndarray:
    levels = decode_image(path, path, ("PNG",), SOURCE_PIXELS, mend=_MEND)
    if levels.shape[2:] != (4,) or levels.dtype != np.uint8:
        raise InputError(path, "image", "is not an 8-bit RGBA image", _MEND)
    return levels


def is_vehicle_file(name: str | Path) -> bool:
    """Whether the name is that of a vehicle file; the file need not exist."""
    return str(name).lower().endswith(VEHICLE_SUFFIXES)


def is_actor_folder(path: Path) -> bool:
    """Whether it is a folder that `save_actor` wrote."""
    return (path / ACTOR_FILE).is_file()


def vehicle_generator(
    path: str | Path, axes: str = AUTO, spacing: float | None = None
) -> ActorGenerator:
    """What takes the vehicle of a file or of an actor's folder.

    Args:
        axes: orientation of a file, see `recast.actors.axes_of`; an actor knows its own.
        spacing: metres between the points of a mesh; its own if None.

    Raises:
        InputError: no such file, no such axes, or a GLB that cannot be opened.
    """
    path = Path(path)
    if is_actor_folder(path):
        return ActorFolderGenerator(path)
    if not path.is_file():
        raise InputError(path, "file", "is missing", "check the path given as `generator`")
    if holds_gaussians(path):
        return SplatGenerator(path, axes)
    return MeshGenerator(path, axes) if spacing is None else MeshGenerator(path, axes, spacing)


def files_of_vehicle(path: Path) -> list[Path]:
    """The file and all others that it names.

    Raises:
        InputError: see `files_of_mesh`.
    """
    return files_of_mesh(path) if path.suffix.lower() in MESH_SUFFIXES else [path]


class ActorFolderGenerator(BaseGenerator):
    """Takes the vehicle of an actor that was made for another track."""

    name = "actor"

    def __init__(self, path: Path) -> None:
        self.path = path

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Read the folder; the vehicle keeps its size.

        Raises:
            InputError: see `load_actor`.
        """
        actor = load_actor(self.path)
        details = {"file": self.path.name, "made_by": actor.provenance.generator}
        return Asset(actor.gaussians, VEHICLE, self.name, seed, details, actor.low_pass)
