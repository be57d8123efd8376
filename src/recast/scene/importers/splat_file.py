"""Streets in files of Gaussians that any program wrote."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from recast.core.errors import InputError
from recast.core.files import require_new
from recast.logs import DrivingLog
from recast.scene.importers.placement import (
    ImportRecord,
    Placement,
    given_placement,
    write_imported,
)
from recast.scene.sky import SkyMap, read_sky
from recast.scene.street_scene import StreetScene
from recast.splats.formats import FORMATS, format_of, read_gaussians


def import_gaussians(
    path: str | Path,
    log: DrivingLog,
    out: str | Path,
    world_from_file: Path | None = None,
    sky: Path | None = None,
) -> ImportRecord:
    """Make a scene without actors of a PLY (INRIA layout), glTF, SPZ or OpenUSD file.

    Files whose format has other axes are turned first, see `recast.splats.formats`.

    Args:
        world_from_file: text file with a 4x4 matrix or an offset from the file's coordinates
            (turned: x forward, y left, z up) to the log's world; the matrix may scale. Without it
            they are taken to be the same.
        sky: equirectangular image as `recast scene export` writes it; black without it.

    Raises:
        InputError: a file is missing, broken or of no known format, it is empty, `out` exists.
    """
    path = Path(path)
    require_new(out)
    background = read_gaussians(path, double=True)
    if len(background) == 0:
        raise InputError(path, "Gaussians", "there are none", "export it again")
    placement = Placement(np.eye(4), "taken for the log's world")
    if world_from_file is not None:
        placement = given_placement(world_from_file, scalable=True)
        pose = torch.from_numpy(placement.world_from_scene)
        background = background.transformed(pose, placement.scale)
    seen = SkyMap.constant(torch.zeros(3)) if sky is None else read_sky(sky)
    no_sky = "sky: the file has none, and no image of one was given; it is black"
    layout = next(name for name, one in FORMATS.items() if one is format_of(path))
    return write_imported(
        path,
        log,
        out,
        placement,
        StreetScene(background, {}, seen),
        layout=layout,
        tracks={},
        left_out=() if sky else (no_sky,),
    )
