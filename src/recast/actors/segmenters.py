"""Segmenters by name, by the folder that holds their networks, or as objects."""

from __future__ import annotations

from pathlib import Path

from recast.actors.grounded_segmenter import GroundedSamSegmenter
from recast.actors.segment import Segmenter
from recast.errors import InputError
from recast.parts import SEGMENTERS

DEFAULT_SEGMENTER = "box-lidar"


def segmenter_of(segmenter: str | Path | Segmenter) -> Segmenter:
    """A segmenter by its name, Grounding DINO with SAM from a folder, or the object given.

    Args:
        segmenter: see `recast.plugins.Registry.resolve`. A name goes before a folder of the same
            name: write `./NAME` for that one.

    Raises:
        InputError: no such segmenter or folder, a folder without its networks, or an object that is
            not a segmenter.
    """
    found: Segmenter = SEGMENTERS.resolve(segmenter)
    return found


def grounded_segmenter(folder: Path) -> Segmenter:
    """Grounding DINO with SAM from a folder.

    Raises:
        InputError: no such folder, or a network is missing.
    """
    if not folder.is_dir():
        raise InputError(
            "--segmenter", str(folder), "is no folder",
            "name the folder that holds grounding-dino and sam",
        )  # fmt: skip
    return GroundedSamSegmenter(folder)


def is_segmenter_folder(name_or_folder: str) -> bool:
    """Whether `segmenter_of` would read a folder."""
    return SEGMENTERS.place(name_or_folder) is not None
