"""An actor for other programs: its vehicle and its shadow as files of Gaussians."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from recast.actors.actor import Actor
from recast.core.files import atomic_folder, write_json
from recast.scene.export import CONVENTIONS
from recast.splats import Gaussians, LowPass
from recast.splats.formats import format_named, write_gaussians

EXPORT_VERSION = 1
EXPORT_FORMAT = "recast-actor-export"
RECORD_FILE, VEHICLE, SHADOW = "actor.json", "vehicle", "shadow"
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
        VEHICLE: (actor.gaussians, actor.low_pass)
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
