"""Scenes that others trained, as ours: checkpoints and PLY files, of which no code is ever run."""

from recast.scene.importers.drivestudio import import_drivestudio
from recast.scene.importers.hugsim import import_hugsim
from recast.scene.importers.hugsim_log import hugsim_log, import_hugsim_with_log
from recast.scene.importers.mtgs import import_mtgs
from recast.scene.importers.mtgs_log import import_mtgs_with_log, mtgs_log
from recast.scene.importers.placement import IMPORT_FILE, ImportRecord
from recast.scene.importers.splat_file import import_gaussians
from recast.scene.importers.street_gaussians import import_street_gaussians

__all__ = [
    "IMPORT_FILE",
    "ImportRecord",
    "hugsim_log",
    "import_drivestudio",
    "import_gaussians",
    "import_hugsim",
    "import_hugsim_with_log",
    "import_mtgs",
    "import_mtgs_with_log",
    "import_street_gaussians",
    "mtgs_log",
]
