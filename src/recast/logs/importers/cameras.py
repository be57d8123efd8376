"""The cameras to import, chosen by name; the same for every dataset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from recast.errors import InputError


def chosen_cameras(where: Path, there: Iterable[str], wanted: Sequence[str]) -> list[str]:
    """Names of the cameras to import, in the order in which they are there.

    Args:
        where: the drive, for messages.
        there: names of all cameras of the drive.
        wanted: names of the cameras to import; all if empty.

    Raises:
        InputError: a wanted camera is not there; the message lists the cameras that are.
    """
    names = list(there)
    for name in wanted:
        if name not in names:
            listed = ", ".join(names)
            mend = f"choose from {listed}" if listed else "leave the option out"
            raise InputError(where, "cameras", f"has no camera {name!r}", mend)
    return [name for name in names if not wanted or name in wanted]
