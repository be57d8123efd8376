"""Check of a drive's name from the command line, before it becomes part of a path."""

from __future__ import annotations

import os
from pathlib import Path

from recast.errors import InputError

_NAME_BYTES = 240
"""Longest name of a drive: file systems take 255 bytes, with its suffix."""


def check_drive(root: Path, drive: str) -> None:
    """Check that a drive's name is one file name, which leads to nowhere else.

    Raises:
        InputError: it is empty, too long, or holds a slash or a NUL.
    """
    wrong = not drive or drive in (".", "..") or len(os.fsencode(drive)) > _NAME_BYTES
    if wrong or "/" in drive or "\\" in drive or "\0" in drive:
        raise InputError(root, "drive", f"{drive!r} is no name of a drive", "give its name alone")
