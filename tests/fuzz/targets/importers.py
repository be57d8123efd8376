"""Datasets as their importers read them: calibration, poses, boxes, and a taste of the sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from fuzz.target import Target
from recast.logs import DrivingLog
from recast.logs.importers.argoverse2 import load_argoverse2
from recast.logs.importers.kitti import load_kitti
from recast.logs.importers.nuscenes import load_nuscenes
from recast.logs.importers.waymo import load_waymo, load_waymo2
from recast_bridges.logs.drivestudio import load_drivestudio
from recast_bridges.logs.street_gaussians import load_street_gaussians
from support import (
    tiny_argoverse2,
    tiny_drive,
    tiny_nuscenes,
    tiny_processed,
    tiny_waymo,
)
from support.tiny_waymo2 import write_segment as write_waymo2_segment


def taste(log: DrivingLog) -> tuple[Any, ...]:
    """All of a log that is in memory, the first and last image and sweep of each sensor."""
    log.validate()
    images = [s.images[i] for s in log.cameras.values() for i in (0, -1) if len(s.timestamps_us)]
    sweeps = [s.sweeps[i] for s in log.lidars.values() for i in (0, -1) if len(s.timestamps_us)]
    # The ground's height is NaN where nothing is known of it.
    lanes = None if log.map is None else replace(log.map, ground=None)
    return log.tracks, log.world_from_rig, lanes, log.cameras, images, sweeps


def _importer(
    name: str,
    write: Callable[[Path], object],
    load: Callable[[Path], DrivingLog],
    weight: float = 1.0,
    files: tuple[str, ...] = ("*",),
) -> Target:
    return Target(name, write, lambda folder, out: taste(load(folder)), files, weight)


TARGETS = (
    _importer(
        "kitti",
        tiny_drive.write_tiny_drive,
        lambda root: load_kitti(root, tiny_drive.DRIVE, root / "labels.txt", refine=False),
        0.4,
    ),
    _importer(
        "kitti-tracklets",
        lambda root: (
            tiny_drive.write_tiny_drive(root),
            tiny_drive.write_tracklets(root / tiny_drive.DATE / "tracklets.xml"),
        ),
        lambda root: load_kitti(
            root, tiny_drive.DRIVE, root / tiny_drive.DATE / "tracklets.xml", refine=False
        ),
        weight=0.4,
        files=("*tracklets.xml",),
    ),
    _importer(
        "argoverse2",
        tiny_argoverse2.write_tiny_log,
        lambda root: load_argoverse2(root, tiny_argoverse2.LOG),
        2.0,
    ),
    _importer(
        "waymo", tiny_waymo.write_segment, lambda root: load_waymo(root, tiny_waymo.FILE), 2.0
    ),
    _importer(
        "waymo-v2",
        write_waymo2_segment,
        lambda root: load_waymo2(root, tiny_waymo.NAME),
        2.0,
    ),
    _importer(
        "nuscenes",
        tiny_nuscenes.write_tiny_nuscenes,
        lambda root: load_nuscenes(root, tiny_nuscenes.SCENE),
        2.0,
    ),
    _importer(
        "street-gaussians-folder",
        tiny_processed.write_street_gaussians,
        lambda root: load_street_gaussians(root, tiny_processed.SCENE),
    ),
    _importer(
        "drivestudio-folder",
        tiny_processed.write_drivestudio,
        lambda root: load_drivestudio(root, tiny_processed.SCENE),
    ),
)
