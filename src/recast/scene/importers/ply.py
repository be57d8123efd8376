"""Any 3D Gaussian splatting PLY as the static background of a log."""

from __future__ import annotations

from pathlib import Path

import torch

from recast.core.errors import InputError
from recast.core.files import require_new
from recast.logs import DrivingLog
from recast.scene.importers.placement import (
    Imported,
    ImportRecord,
    Placement,
    given_placement,
    write_imported,
)
from recast.scene.sky import SkyMap, read_sky
from recast.scene.street_scene import StreetScene
from recast.splats import read_ply


def import_ply(
    path: str | Path,
    log: DrivingLog,
    out: str | Path,
    world_from_ply: Path | None = None,
    sky: Path | None = None,
) -> ImportRecord:
    """Make a scene without actors of a PLY in the INRIA layout.

    Args:
        world_from_ply: text file with a 4x4 matrix or an offset from the PLY's coordinates to the
            log's world; the matrix may scale. Without it they are taken to be the same.
        sky: equirectangular image as `recast scene export` writes it; black without it.

    Raises:
        InputError: a file is missing or broken, the PLY is empty, `out` exists.
    """
    path = Path(path)
    require_new(out)
    background = read_ply(path)
    if len(background) == 0:
        raise InputError(path, "element vertex", "has no rows", "export it again")
    placement = Placement(torch.eye(4, dtype=torch.float64).numpy(), "taken for the log's world")
    if world_from_ply is not None:
        placement = given_placement(world_from_ply, scalable=True)
        pose = torch.from_numpy(placement.world_from_scene)
        background = background.transformed(pose, placement.scale)
    left_out = () if sky else ("sky: a PLY has none, and no image of one was given; it is black",)
    imported = Imported(
        layout="ply",
        scene=StreetScene(
            background=background,
            actors={},
            sky=SkyMap.constant(torch.zeros(3)) if sky is None else read_sky(sky),
            world_offset=log.world_offset,
            log_name=log.name,
        ),
        placement=placement,
        tracks={},
        left_out=left_out,
    )
    return write_imported(imported, path, log, out)
