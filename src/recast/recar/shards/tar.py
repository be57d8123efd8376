"""Tar archives whose bytes depend on nothing but names and contents of their members."""

from __future__ import annotations

import tarfile

BLOCK = 512
END = bytes(2 * BLOCK)
"""Closes every archive."""


def member_header(name: str, size: int) -> bytes:
    """Header of a regular file: no owner, no time; POSIX ustar, with pax only for long names."""
    info = tarfile.TarInfo(name)
    info.size, info.mode, info.mtime = size, 0o644, 0
    return info.tobuf(tarfile.PAX_FORMAT, "utf-8", "strict")


def padding(size: int) -> bytes:
    """Zeros that bring a member's bytes to whole blocks."""
    return bytes(-size % BLOCK)


def stored_bytes(name: str, size: int) -> int:
    """What a member takes in the archive: header, bytes and padding."""
    return len(member_header(name, size)) + size + len(padding(size))
