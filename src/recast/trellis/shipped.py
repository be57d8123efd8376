"""The small model that comes with the package."""

from __future__ import annotations

from pathlib import Path

RECAST_MINI = "recast-mini"
"""Its name, as a generator and of its folder."""


def recast_mini() -> Path:
    """Its folder in the published layout, with a model card (README.md)."""
    return Path(__file__).parent / RECAST_MINI
