"""Training state on disk: what a killed run goes on from, to the same last byte."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from recast.core.errors import InputError
from recast.logs import GroundHeight
from recast.scene.initialise import Initialisation
from recast.scene.points import DepthSamples
from recast.scene.sky import SkyMap
from recast.scene.tensor_file import read_tensors, write_tensors
from recast.scene.trainable import STATES, rows
from recast.scene.trainer import Trainer
from recast.splats import Gaussians


def save_checkpoint(trainer: Trainer, notes: Mapping[str, Any], path: Path) -> None:
    """Write parameters, optimiser states, statistics and the iteration, atomically.

    `notes` are the caller's own, JSON-able, and come back from `load_checkpoint`.

    Random numbers need no state: each is drawn from a generator seeded by seed and iteration.
    """
    model = trainer.model
    tensors: dict[str, Tensor] = {"owner": model.owner}
    if model.fourier.shape[1]:
        tensors["waves"] = model.fourier
    tensors |= _prefixed("background", rows(model.background))
    tensors |= _prefixed("local", rows(model.local))
    for name, table in trainer.tables().items():
        tensors |= _prefixed(name, table.state_dict())
    for name in STATES:
        tensors |= _prefixed(name, getattr(model, name).state_dict())
    header = {
        "iteration": trainer.iteration,
        "limited_from": trainer.limited_from,
        "limited_changes": trainer.limited_changes,
        "notes": notes,
    }
    write_tensors(path, tensors, header)


def load_checkpoint(trainer: Trainer, path: Path) -> dict[str, Any]:
    """Put a fresh trainer of the same run where the checkpoint left off; returns the notes.

    Raises:
        InputError: the file is missing or broken.
    """
    with _broken(path):
        tensors, header = read_tensors(path)
        model = trainer.model
        local = Gaussians(**_group(tensors, "local"))
        model.place(
            Gaussians(**_group(tensors, "background")).to(trainer.device),
            local.to(trainer.device),
            tensors["owner"],
            tensors.get("waves", torch.zeros(len(local), 0, 3)).to(trainer.device),
        )
        model.restore({name: _group(tensors, name) for name in STATES})
        for name, table in trainer.tables().items():
            table.load_state_dict(_group(tensors, name))
        trainer.iteration = int(header["iteration"])
        trainer.limited_from = header["limited_from"]
        trainer.limited_changes = int(header["limited_changes"])
        return dict(header["notes"])


def save_initialisation(start: Initialisation, path: Path) -> None:
    """Keep the first scene, so that a run taken up again need not build it anew."""
    tensors = _prefixed("background", rows(start.background)) | {"sky": start.sky.colours}
    for track_id, part in start.actors.items():
        tensors |= _prefixed(f"actor/{track_id}", rows(part))
    for index, (sky, depths) in enumerate(zip(start.sky_pixels, start.depths, strict=True)):
        tensors[f"view/{index}/sky"] = torch.from_numpy(sky)
        tensors[f"view/{index}/depths"] = torch.from_numpy(depths.depths)
        tensors[f"view/{index}/uv"] = torch.from_numpy(depths.uv)
    header: dict[str, Any] = {
        "actors": list(start.actors),
        "views": len(start.depths),
        "found": start.found,
    }
    if start.ground is not None:
        tensors["ground:origin"] = torch.from_numpy(start.ground.origin)
        tensors["ground:height"] = torch.from_numpy(start.ground.height)
        header["ground_cell_m"] = start.ground.cell
    write_tensors(path, tensors, header)


def load_initialisation(path: Path) -> Initialisation:
    """Read `save_initialisation`'s file; InputError if the file is missing or broken."""
    with _broken(path):
        tensors, header = read_tensors(path)
        views = range(header["views"])
        ground = None
        if "ground_cell_m" in header:
            part = _group(tensors, "ground")
            ground = GroundHeight(
                part["origin"].numpy(), header["ground_cell_m"], part["height"].numpy()
            )
        start = Initialisation(
            background=Gaussians(**_group(tensors, "background")),
            actors={
                name: Gaussians(**_group(tensors, f"actor/{name}")) for name in header["actors"]
            },
            sky=SkyMap(tensors["sky"]),
            sky_pixels=[tensors[f"view/{i}/sky"].numpy().astype(np.int64) for i in views],
            depths=[
                DepthSamples(tensors[f"view/{i}/depths"].numpy(), tensors[f"view/{i}/uv"].numpy())
                for i in views
            ],
            ground=ground,
            found=header["found"],
        )
        for gaussians in (start.background, *start.actors.values()):
            gaussians.validate()
    return start


@contextmanager
def _broken(path: Path) -> Iterator[None]:
    """What a file of ours lacks, or has of another kind or shape, is one clear line."""
    try:
        yield
    except InputError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        problem = f"is not a checkpoint of this version ({type(error).__name__}: {error})"
        raise InputError(path, "state", problem, "remove work/ and train again") from error


def _prefixed(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {f"{prefix}:{name}": tensor for name, tensor in tensors.items()}


def _group(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    start = f"{prefix}:"
    return {name[len(start) :]: t for name, t in tensors.items() if name.startswith(start)}
