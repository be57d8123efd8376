"""What an import made of a foreign scene, told to people and kept beside the scene."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.logs import DrivingLog
from recast.records import Record
from recast.scene.importers.placing import Placement, drive_inside
from recast.scene.run_identity import log_fingerprint
from recast.scene.store import save_scene
from recast.scene.street_scene import StreetScene
from recast.storage import atomic_folder, write_json

IMPORT_VERSION = 1
IMPORT_FILE = "import.json"
MATCHED_SHARE = 0.5
"""With fewer ego positions within the background's bounds the frames are taken to differ."""


class ImportRecord(Record):
    """Contents of import.json.

    Attributes:
        layout: of the file: street-gaussians, drivestudio or ply.
        file, sha256: what was imported.
        iteration: training step of a checkpoint.
        log_name, log_fingerprint: the log it was placed in.
        world_from_scene: 4x4, row by row; scene coordinates are scaled by `scale` first.
        placed_by: where this transform comes from.
        drive_inside: share of the ego positions within the background's bounds.
        tracks: track of the log by name in the file.
        changed: what was carried over in another form, one sentence each.
        left_out: what was not carried over, one sentence each.
        warnings: what looks wrong.
    """

    version: int = IMPORT_VERSION
    layout: str
    file: str
    sha256: str
    iteration: int | None
    log_name: str
    log_fingerprint: str
    world_from_scene: list[list[float]]
    scale: float
    placed_by: str
    drive_inside: float
    tracks: dict[str, str]
    changed: list[str]
    left_out: list[str]
    warnings: list[str]


@dataclass(frozen=True)
class Imported:
    """A foreign scene in our form, before it is written.

    Attributes are those of `ImportRecord`.
    """

    layout: str
    scene: StreetScene
    placement: Placement
    tracks: dict[str, str]
    changed: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    iteration: int | None = None


def write_imported(
    imported: Imported, source: Path, log: DrivingLog, out: str | Path
) -> ImportRecord:
    """Write the scene folder with its import.json, whole or not at all.

    Raises:
        InputError: `out` exists, the disk refuses, or the placed scene is not valid.
    """
    try:
        imported.scene.validate()
    except ValueError as error:
        mend = "check the placement and the values of the file"
        raise InputError(source, "scene", str(error), mend) from None
    inside = drive_inside(log, imported.scene.background)
    warnings = list(imported.warnings)
    if inside < MATCHED_SHARE:
        warnings.append(
            f"only {inside:.0%} of the recorded ego positions lie within the background: "
            "scene and log seem to have different frames"
        )
    with source.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    record = ImportRecord(
        layout=imported.layout,
        file=source.name,
        sha256=digest,
        iteration=imported.iteration,
        log_name=log.name,
        log_fingerprint=log_fingerprint(log),
        world_from_scene=np.asarray(imported.placement.world_from_scene).tolist(),
        scale=imported.placement.scale,
        placed_by=imported.placement.how,
        drive_inside=inside,
        tracks=imported.tracks,
        changed=list(imported.changed),
        left_out=list(imported.left_out),
        warnings=warnings,
    )
    with atomic_folder(out) as partial:
        write_json(partial / IMPORT_FILE, record.model_dump(mode="json"))
        save_scene(imported.scene, partial)
    return record
