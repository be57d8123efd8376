"""Scenes that others trained, as ours: checkpoints and PLY files, of which no code is ever run."""

from recast.scene.importers.drivestudio import import_drivestudio
from recast.scene.importers.hugsim import import_hugsim
from recast.scene.importers.mtgs import import_mtgs
from recast.scene.importers.placement import IMPORT_FILE, ImportRecord
from recast.scene.importers.splat_file import import_gaussians
from recast.scene.importers.street_gaussians import import_street_gaussians

__all__ = [
    "IMPORT_FILE",
    "ImportRecord",
    "import_drivestudio",
    "import_gaussians",
    "import_hugsim",
    "import_mtgs",
    "import_street_gaussians",
]
