"""Named tensors with a JSON header in a safetensors file, and the actors that are kept so.

Actors that change their shape are two such files, each with its version in the header:
deformation.safetensors holds the network of the deformable nodes and a code for each actor,
bodies.safetensors the bodies on skeletons.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save
from torch import Tensor

from recast.core.errors import InputError
from recast.core.files import parse_json, write_bytes
from recast.core.torch_file import read_safetensors
from recast.scene.bodies import Skinning
from recast.scene.deformation import MOST_LAYERS, Deformation, DeformationNetwork

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
