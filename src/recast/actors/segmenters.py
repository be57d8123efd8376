"""Segmenters by name, or by the folder that holds their networks."""

from __future__ import annotations

from pathlib import Path

from recast.actors.grounded_segmenter import GroundedSamSegmenter
from recast.actors.segment import Segmenter
from recast.errors import InputError
from recast.parts import SEGMENTERS

DEFAULT_SEGMENTER = "box-lidar"


def segmenter_of(name_or_folder: str) -> Segmenter:
    """A segmenter by its name, or Grounding DINO with SAM from a folder.

    A name goes before a folder of the same name: write `./NAME` for that one.

    Args:
        name_or_folder: see `SEGMENTERS` and `GroundedSamSegmenter`.

    Raises:
        InputError: no such segmenter or folder, or a folder without its networks.
    """
    if is_segmenter_folder(name_or_folder):
        return GroundedSamSegmenter(name_or_folder)
    if "/" in name_or_folder and ":" not in name_or_folder:
        raise InputError(
            "--segmenter", name_or_folder, "is no folder",
            "name the folder that holds grounding-dino and sam",
        )  # fmt: skip
    segmenter: Segmenter = SEGMENTERS.load(name_or_folder)()
    return segmenter


def is_segmenter_folder(name_or_folder: str) -> bool:
    """Whether `segmenter_of` would read a folder."""
    return name_or_folder not in SEGMENTERS.names() and Path(name_or_folder).is_dir()
