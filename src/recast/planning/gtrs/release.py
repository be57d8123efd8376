"""A released GTRS checkpoint, once fetched, as a folder that needs no pickle any more."""

from __future__ import annotations

import shutil
from pathlib import Path

from recast.planning.gtrs.folder import load_checkpoint, save_gtrs

CHECKPOINT, VOCABULARY, PLANNER = "gtrs_dense_vov.ckpt", "8192.npy", "planner"


def convert_release(folder: Path) -> None:
    """Write `planner/` (see `save_gtrs`) from the checkpoint and the vocabulary in a folder.

    Raises:
        InputError: see `load_checkpoint` and `save_gtrs`.
    """
    planner = load_checkpoint(folder / CHECKPOINT, folder / VOCABULARY)
    shutil.rmtree(folder / PLANNER, ignore_errors=True)  # of a try that was killed
    save_gtrs(folder / PLANNER, planner)
