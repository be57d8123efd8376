"""What a synthetic set is to hold, decided and checked before any work."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from recast.core.errors import InputError
from recast.recar.record import (
    HELD_OUT_SHARE,
    LARGEST_SIDE,
    MOST_VIEWS,
    SetRecord,
    Split,
    regular_azimuths,
    split_of,
)
from recast.recar.views import ELEVATION_DEG, FOV_DEG

SYNTHESIS_VERSION = 1
"""Changes when the same settings give other pictures; a killed run never mixes two."""

_AXES = {".glb": "z,y", ".gltf": "z,y"}  # forward and up by the format's own rule

Group = Literal["vehicle", "shape", "mesh"]


@dataclass(frozen=True)
class SynthesisSettings:
    """What all identities of a synthetic set share.

    Attributes:
        seed: of everything random, the split too.
        views: pictures of each identity.
        width, height: pixels.
        kinds: of vehicles, drawn evenly; as often as on the road where none is named.
        licence: of the pictures.
        held_out: share of the identities that is never trained on.
    """

    seed: int = 0
    views: int = 30
    width: int = 1200
    height: int = 800
    kinds: tuple[str, ...] = ()
    licence: str = "CC0-1.0"
    held_out: float = HELD_OUT_SHARE

    def validate(self) -> None:
        """Raise InputError naming the option at fault."""
        from recast.synthetic.vehicles import KINDS

        if self.seed < 0:
            raise InputError("--seed", "value", f"is {self.seed}", "give 0 or more")
        if not 1 <= self.views <= MOST_VIEWS:
            raise InputError("--views", "value", f"is {self.views}", f"give 1 to {MOST_VIEWS}")
        for option, pixels in (("--width", self.width), ("--height", self.height)):
            if not 16 <= pixels <= LARGEST_SIDE:
                raise InputError(option, "value", f"is {pixels}", f"give 16 to {LARGEST_SIDE}")
        for kind in self.kinds:
            if kind not in KINDS:
                raise InputError("--kinds", kind, "is unknown", f"choose of {', '.join(KINDS)}")
        if not 0 <= self.held_out <= 1:
            raise InputError("--held-out", "value", f"is {self.held_out}", "give 0 to 1")
        if not self.licence.strip():
            raise InputError("--licence", "value", "is empty", "name the licence of the pictures")

    def record(self, name: str, identities: int) -> SetRecord:
        """The record of the finished set."""
        return SetRecord(
            complete=True,
            name=name,
            licence=self.licence,
            source="renders of parametric vehicles by `recast recar synth`",
            identities=identities,
            azimuths_deg=regular_azimuths(self.views),
            elevation_deg=ELEVATION_DEG,
            fov_deg=FOV_DEG,
            width=self.width,
            height=self.height,
            split_seed=self.seed,
            held_out_share=self.held_out,
            generator={
                "name": "recast.recar.synthesize_set",
                "synthesis_version": SYNTHESIS_VERSION,
                "seed": self.seed,
                "kinds": list(self.kinds),
            },
        )


@dataclass(frozen=True)
class PlannedIdentity:
    """One identity to make.

    Attributes:
        id: its name in the set.
        group: what makes its shape.
        seed: of its shape and light; depends on nothing but the set's seed and its own place.
        split: decided beforehand.
        mesh: the file, of the group "mesh".
        mesh_axes: its forward and up axes.
    """

    id: str
    group: Group
    seed: tuple[int, ...]
    split: Split
    mesh: Path | None = None
    mesh_axes: str = ""


def plan_identities(
    settings: SynthesisSettings,
    vehicles: int,
    shapes: int,
    meshes: Sequence[Path],
    mesh_axes: str | None = None,
) -> list[PlannedIdentity]:
    """All identities of a set, in the order in which they are made.

    Raises:
        InputError: a negative count, nothing at all, or a mesh file that is missing or named twice.
    """
    for option, count in (("--vehicles", vehicles), ("--shapes", shapes)):
        if count < 0:
            raise InputError(option, "value", f"is {count}", "give 0 or more")
    if vehicles + shapes + len(meshes) == 0:
        raise InputError("--vehicles", "value", "is 0 with nothing else asked", "give 1 or more")
    plan = [_planned(settings, "vehicle", i, f"vehicle-{i:05d}", i) for i in range(vehicles)]
    plan += [_planned(settings, "shape", i, f"shape-{i:05d}", i) for i in range(shapes)]
    for index, path in enumerate(meshes):
        axes = mesh_axes or _AXES.get(path.suffix.lower(), "x,z")
        digest = _digest(path, axes)
        stem = re.sub(r"[^A-Za-z0-9_-]", "-", path.stem)[:60]
        name = f"mesh-{stem}-{digest}"
        plan.append(_planned(settings, "mesh", index, name, int(digest, 16), path, axes))
    known: set[str] = set()
    for one in plan:
        if one.id in known:
            raise InputError(one.mesh or one.id, "mesh", "is named twice", "name it once")
        known.add(one.id)
    return plan


def _planned(
    settings: SynthesisSettings,
    group: Group,
    index: int,
    name: str,
    own_seed: int,
    mesh: Path | None = None,
    mesh_axes: str = "",
) -> PlannedIdentity:
    stream = ("vehicle", "shape", "mesh").index(group)
    return PlannedIdentity(
        id=name,
        group=group,
        seed=(settings.seed, stream, own_seed),
        split=split_of(name, settings.seed, settings.held_out, index),
        mesh=mesh,
        mesh_axes=mesh_axes,
    )


def _digest(path: Path, axes: str) -> str:
    # Of the content, so that a file that changed is never taken for the finished one.
    if not path.is_file():
        raise InputError(path, "mesh", "is missing", "check the path")
    if len(axes.split(",")) != 2:
        raise InputError("--mesh-axes", "value", f"is {axes!r}", "give forward and up, such as z,y")
    return hashlib.sha256(axes.encode() + path.read_bytes()).hexdigest()[:8]
