"""The small image-conditioned planner that comes with the package."""

from __future__ import annotations

from pathlib import Path

from recast.errors import InputError
from recast.planning.types import Planner

GTRS_MINI = "gtrs-mini"
"""Its name, as a planner and of its folder."""


def gtrs_mini() -> Path:
    """Its folder, in the layout of `recast.planning.gtrs.save_gtrs`."""
    return Path(__file__).parent / GTRS_MINI


def gtrs_mini_planner(device: str = "cpu") -> Planner:
    """The planner.

    Args:
        device: where it computes, as torch calls it.

    Raises:
        InputError: this installation lacks the folder, or it is damaged.
    """
    if not gtrs_mini().is_dir():
        raise InputError(
            "planner", GTRS_MINI, f"its weights are not in this installation ({gtrs_mini()})",
            "install a release that has them, or name the folder of another GTRS planner",
        )  # fmt: skip
    from recast.planning.gtrs import load_gtrs  # here, as it needs torch and others do not

    return load_gtrs(gtrs_mini(), device)
