"""Vehicles in files of Gaussians, in the place of a generator."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import save

from recast.actors.actor import Actor, Provenance, Shares, triple
from recast.actors.generate import (
    AUTO,
    PEOPLE_GENERATOR,
    VEHICLE,
    ActorGenerator,
    Asset,
    AxisConvention,
    BaseGenerator,
    axes_of,
    upright,
)
from recast.actors.icp import outer_surface
from recast.actors.mesh_generator import MESH_SUFFIXES, MeshGenerator, files_of_mesh
from recast.actors.observation import Observation
from recast.core import files
from recast.core.arguments import checked
from recast.core.errors import InputError
from recast.core.files import atomic_folder, write_json
from recast.core.images import decode_image
from recast.core.plugins import GENERATORS
from recast.core.records import Record, read_record
from recast.core.torch_file import read_safetensors
from recast.logs import Trajectory
from recast.logs.images import encode
from recast.scene.deformation import Gait
from recast.scene.exchange import CONVENTIONS
from recast.splats import CLASSIC, MIP, Gaussians, LowPass, read_ply, write_ply
from recast.splats.formats import (
    GLTF,
    format_named,
    format_of,
    has_gaussians,
    splat_suffixes,
    write_gaussians,
)

# Of the published decoder of TRELLIS, in unit cubes (rounded up by what float32 and text lose).
_PER_VOXEL, _LARGEST_SPREAD, _LEAST_DEVIATION = 32, 1.5 / 64 + 1e-5, 9e-4


def holds_gaussians(path: Path) -> bool:
    """Whether a vehicle file holds Gaussians, not a mesh; of a GLB its content tells. Raises
    InputError: a GLB cannot be opened."""
    suffix = path.suffix.lower()
    return has_gaussians(path) if suffix == GLTF.suffix else suffix in splat_suffixes()


class SplatGenerator(BaseGenerator):
    """Takes the Gaussians of a PLY, glTF, SPZ or OpenUSD file whatever the observation shows.

    Args:
        path: the file.
        axes: its axis convention, as such or as text, see `axes.axes_of`, of the axes that the file
            itself has (OpenUSD: with z up); "auto" tells which axis points up from the shape and
            the observed box, see `recast.actors.generate.upright`.
        low_pass: the filter that it was made for. None takes what the file declares
            (`recast.splats.formats`); if it declares none, that of TRELLIS for what its published
            decoder made (`made_by_trellis`), else that of 3DGS.

    Raises:
        InputError: no such convention, or no such format.
    """

    def __init__(
        self, path: str | Path, axes: str | AxisConvention = AUTO, low_pass: LowPass | None = None
    ) -> None:
        self.path, self.low_pass = Path(path), low_pass
        self.format = format_of(path)
        self.name: str = self.format.name
        self.axes = axes_of(axes) if isinstance(axes, str) and axes != AUTO else axes

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Read the file.

        Raises:
            InputError: the file is missing, lacks a field, or holds a value that is not finite;
                with "auto", no orientation fits the box, or the shape does not tell it.
        """
        gaussians = self.format.read(self.path)
        if len(gaussians) == 0:
            raise InputError(self.path, "vertex", "holds no Gaussians", "export the asset again")
        details: dict[str, str | float | int] = {"file": self.path.name}
        if isinstance(self.axes, AxisConvention):
            axes = self.axes
        else:
            try:
                points = outer_surface(gaussians).points
            except ValueError as error:
                mend = "export the asset again"
                raise InputError(self.path, "shape", str(error), mend) from None
            found = upright(points, observation.size, self.path)
            axes, details["axes"] = found.axes, f"inferred from the shape: {found.explain()}"
        low_pass = self.low_pass or self.format.low_pass(self.path)
        if low_pass is None:
            low_pass = MIP if made_by_trellis(gaussians) else CLASSIC
        return Asset(gaussians, axes, self.name, seed, details, low_pass)


def made_by_trellis(gaussians: Gaussians) -> bool:
    """Whether these are, row by row, what the published decoder of TRELLIS gives.

    32 Gaussians for each voxel of 1/64, within three quarters of a voxel of its centre; no
    harmonics; no deviation below 9e-4.
    """
    if gaussians.sh_degree > 0 or len(gaussians) == 0 or len(gaussians) % _PER_VOXEL:
        return False
    voxels = gaussians.means.reshape(-1, _PER_VOXEL, 3)
    spread = float((voxels.amax(dim=1) - voxels.amin(dim=1)).max())
    least = float(gaussians.log_scales.min())
    return spread <= _LARGEST_SPREAD and least >= np.log(_LEAST_DEVIATION) - 1e-4


# Vehicles in files: actors' folders, and files of Gaussians or meshes in place of a generator.
#
# The folder of an actor holds actor.json, a PLY file, tensors and the source image.

ACTOR_VERSION = 3
ACTOR_FILE = "actor.json"
VEHICLE_FILE = "vehicle.ply"
SHADOW_FILE = "shadow.safetensors"
SOURCE_FILE = "source.png"
REFINED_FILE = "refined.safetensors"
GAIT_FILE = "gait.safetensors"

SOURCE_PIXELS = 1 << 26
"""Pixels of a source image, at most: a crop of a camera's image has far fewer."""

_MEND = "generate the actor again with this version of recast"
_FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")
_GAIT = ("rotations", "translations", "way")
_SEEN = "seen_shadow."  # before the fields of that shadow
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
        if actor.gait is not None:
            files.write_bytes(partial / GAIT_FILE, save(_gait(actor.gait)))
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
    shares, trajectory, sun, seen_shadow = None, None, None, None
    walks = (folder / GAIT_FILE).exists() or record.provenance.generator == PEOPLE_GENERATOR
    refinement = record.provenance.refinement
    if refinement is not None and refinement.kept:
        shares, trajectory, sun, seen_shadow = _read_refined(folder / REFINED_FILE)
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
        seen_shadow=seen_shadow,
        gait=_read_gait(folder / GAIT_FILE) if walks else None,
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


def _read_shadow(path: Path, start: str = "") -> Gaussians:
    tensors = _tensors(path, [start + name for name in _FIELDS])
    shadow = Gaussians(**{name: tensors[start + name] for name in _FIELDS})
    fault = shadow.fault()
    if fault is not None:
        raise InputError(path, *fault, _MEND)
    return shadow


def _refined(actor: Actor) -> dict[str, torch.Tensor]:
    """What refinement adds to an actor, by name."""
    assert actor.shares is not None and actor.trajectory is not None
    found = {
        "seen": actor.shares.seen.contiguous(),
        "mirrored": actor.shares.mirrored.contiguous(),
        "timestamps_us": torch.from_numpy(actor.trajectory.timestamps_us).contiguous(),
        "poses": torch.from_numpy(actor.trajectory.poses).contiguous(),
    }
    if actor.sun is not None:
        found["sun"] = torch.from_numpy(actor.sun).contiguous()
    if actor.seen_shadow is not None:
        shadow = actor.seen_shadow
        found |= {_SEEN + name: getattr(shadow, name).contiguous() for name in _FIELDS}
    return found


def _read_refined(
    path: Path,
) -> tuple[Shares, Trajectory, NDArray[np.float64] | None, Gaussians | None]:
    """Shares, trajectory; sun and seen shadow, which a person has not."""
    types = dict.fromkeys(("seen", "mirrored"), torch.float32)
    types |= {"timestamps_us": torch.int64, "poses": torch.float64}
    tensors = _typed(path, types)
    times, poses = tensors["timestamps_us"].numpy(), tensors["poses"].numpy()
    if times.ndim != 1:
        raise InputError(path, "timestamps_us", f"has shape {times.shape}", _MEND)
    shares, trajectory = Shares(tensors["seen"], tensors["mirrored"]), Trajectory(times, poses)
    sun = _typed(path, {"sun": torch.float64})["sun"].numpy() if "sun" in tensors else None
    seen = any(name.startswith(_SEEN) for name in tensors)
    return shares, trajectory, sun, _read_shadow(path, _SEEN) if seen else None


def _typed(path: Path, types: Mapping[str, torch.dtype]) -> dict[str, torch.Tensor]:
    """The tensors of a file, of which some must be there and of these types."""
    tensors = _tensors(path, types)
    for name, kind in types.items():
        if tensors[name].dtype != kind:
            raise InputError(path, name, f"is {tensors[name].dtype}, not {kind}", _MEND)
    return tensors


def _gait(gait: Gait) -> dict[str, torch.Tensor]:
    arrays = {name: torch.from_numpy(getattr(gait, name)).contiguous() for name in _GAIT}
    steps = torch.tensor([gait.cycle, gait.phase], dtype=torch.float64)
    return {**arrays, "weights": gait.weights.contiguous(), "steps": steps}


def _read_gait(path: Path) -> Gait:
    types = dict.fromkeys((*_GAIT, "steps"), torch.float64)
    tensors = _typed(path, {**types, "weights": torch.float32})
    if tuple(tensors["steps"].shape) != (2,) or tensors["way"].ndim != 2:
        raise InputError(path, "steps, way", "have other shapes than gaits have", _MEND)
    cycle, phase = tensors["steps"].tolist()
    rotations, translations, way = (tensors[name].numpy() for name in _GAIT)
    return Gait(tensors["weights"], rotations, translations, cycle, phase, way)


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
    """The file and all others that it names. Raises InputError: see `files_of_mesh`."""
    return files_of_mesh(path) if path.suffix.lower() in MESH_SUFFIXES else [path]


class ActorFolderGenerator(BaseGenerator):
    """Takes the vehicle of an actor that was made for another track."""

    name = "actor"

    def __init__(self, path: Path) -> None:
        self.path = path

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Read the folder; a vehicle keeps its size, a person becomes as tall as the box.

        Raises:
            InputError: see `load_actor`.
        """
        actor = load_actor(self.path)
        details = {"file": self.path.name, "made_by": actor.provenance.generator}
        gaussians, gait = actor.gaussians, actor.gait
        if gait is not None:  # a person as tall as the box, on its floor
            share = float(observation.size[2] / actor.size[2])
            gaussians = gaussians.transformed(torch.eye(4), share)
            moved = share * gait.translations
            gait = replace(gait, translations=moved, cycle=share * gait.cycle)
        return Asset(gaussians, VEHICLE, self.name, seed, details, actor.low_pass, gait=gait)


EXPORT_VERSION = 1
EXPORT_FORMAT = "recast-actor-export"
RECORD_FILE, EXPORTED_VEHICLE, SHADOW = "actor.json", "vehicle", "shadow"
_CONVENTIONS = ("units", "actor", "low_pass")


def export_actor(actor: Actor, folder: str | Path, splat_format: str = "ply") -> None:
    """Write the vehicle, the shadow if there is one, and actor.json with size and conventions.

    Args:
        splat_format: see `recast.scene.export_scene`. The vehicle's file can be read again as a
            generator: `vehicle_generator(folder / "vehicle.glb")`.

    Raises:
        InputError: `folder` exists, or the disk is full.
    """
    suffix = format_named(splat_format).suffix
    parts: dict[str, tuple[Gaussians, LowPass | None]] = {
        EXPORTED_VEHICLE: (actor.gaussians, actor.low_pass)
    }
    if len(actor.shadow):
        parts[SHADOW] = (actor.shadow, None)
    conventions = {name: CONVENTIONS[name] for name in _CONVENTIONS}
    record = {
        "format": EXPORT_FORMAT,
        "version": EXPORT_VERSION,
        "track_id": actor.track_id,
        "category": actor.category,
        "size": actor.size.tolist(),
        "low_pass": asdict(actor.low_pass),
        "splat_format": splat_format,
        **{name: f"{name}{suffix}" for name in parts},
        "conventions": conventions | {"gaussians": format_named(splat_format).contents},
    }
    with atomic_folder(folder) as partial:
        for name, (gaussians, low_pass) in parts.items():
            write_gaussians(partial / f"{name}{suffix}", gaussians, low_pass)
        write_json(partial / RECORD_FILE, record)
