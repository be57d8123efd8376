"""Scenes that others trained, as ours: checkpoints of which no code is ever run."""

from recast_bridges.scenes.drivestudio import import_drivestudio
from recast_bridges.scenes.hugsim import hugsim_log, import_hugsim, import_hugsim_with_log
from recast_bridges.scenes.mtgs import import_mtgs, import_mtgs_with_log, mtgs_log
from recast_bridges.scenes.street_gaussians import import_street_gaussians

__all__ = [
    "hugsim_log",
    "import_drivestudio",
    "import_hugsim",
    "import_hugsim_with_log",
    "import_mtgs",
    "import_mtgs_with_log",
    "import_street_gaussians",
    "mtgs_log",
]
