"""USDZ packages: ZIP archives whose members are stored as they are, from multiples of 64 bytes on.

Members are never unpacked to the disk: those that are asked for are read into memory.
"""

from __future__ import annotations

import errno
import io
import struct
import zipfile
from collections.abc import Mapping
from pathlib import Path

from recast.core.errors import InputError
from recast.core.files import atomic_file, disk_errors
from recast.core.names import member

ALIGNMENT = 64
"""Bytes: the data of each member begins at a multiple."""
_PADDING = 0x1986
"""Id of the extra field of a header that fills the gap, as OpenUSD writes it."""
_HEADER, _FIELD = 30, 4
"""Bytes of a member's header without its name, and of an extra field without its content."""
_FIRST_DAY = (1980, 1, 1, 0, 0, 0)
"""Date of every member, the earliest that ZIP knows: same content, same bytes."""
_UNIX, _READABLE = 3, 0o100644 << 16
_ENCRYPTED = 0x1
_READ = 1 << 20
"""Bytes read at once, at most; so also of an archive's directory: some 10,000 members."""
_DAMAGE = (
    zipfile.BadZipFile,
    NotImplementedError,
    RuntimeError,
    EOFError,
    ValueError,
    struct.error,
    OSError,  # of an offset before the file
)
"""What `zipfile` raises of damaged archives."""
_MEND = "give a bundle that AlpaSim can read: a USDZ file with uncompressed members"


def write_usdz(path: str | Path, members: Mapping[str, bytes]) -> None:
    """Write a package, whole or not at all; the same members give the same bytes.

    Args:
        members: content by plain ASCII names, in their order. OpenUSD opens the first one.

    Raises:
        InputError: the disk refuses.
    """
    at = 0
    with atomic_file(path) as partial, zipfile.ZipFile(partial, "w", allowZip64=False) as archive:
        for name, data in members.items():
            info = zipfile.ZipInfo(name, _FIRST_DAY)
            info.create_system, info.external_attr = _UNIX, _READABLE
            begins = at + _HEADER + len(name) + _FIELD
            padding = -begins % ALIGNMENT
            info.extra = struct.pack("<HH", _PADDING, padding) + bytes(padding)
            archive.writestr(info, data)
            at = begins + padding + len(data)


def read_usdz(path: str | Path, limits: Mapping[str, int]) -> dict[str, bytes]:
    """Those of the named members that are there.

    Args:
        limits: most bytes of a member, by name. Others are not read.

    Raises:
        InputError: missing, no ZIP archive or cut off; a member is compressed, encrypted, larger
            than its limit, there twice, damaged, or has a name that leads out of a folder.
    """
    path = Path(path)
    with disk_errors(path):
        if not path.is_file():
            raise InputError(path, "file", "is missing", "check the path")
        try:
            with _Bounded(path) as file, zipfile.ZipFile(file) as archive:
                _check_members(path, archive.infolist(), limits)
                names = [name for name in limits if name in archive.NameToInfo]
                return {name: _read(archive, name) for name in names}
        except InputError:
            raise
        except _DAMAGE as error:
            if isinstance(error, OSError) and error.errno != errno.EINVAL:  # the disk's own
                raise
            raise InputError(path, "archive", f"cannot be read ({error})", _MEND) from None


class _Bounded(io.FileIO):
    """A file of which little is read at once, whatever an archive says of its own sizes."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > _READ:
            raise zipfile.BadZipFile(f"its directory has {size} bytes, more than {_READ}")
        return super().read(size) or b""


def _read(archive: zipfile.ZipFile, name: str) -> bytes:
    with archive.open(name) as stream:  # gives no more bytes than the directory says
        return b"".join(iter(lambda: stream.read(_READ), b""))


def _check_members(path: Path, infos: list[zipfile.ZipInfo], limits: Mapping[str, int]) -> None:
    seen = set()
    for info in infos:
        name = info.filename
        # `orig_filename` has what `filename` was cut off at: a NUL and what follows it.
        member(path, info.orig_filename.rstrip("/") or "/", path, "member")
        field = f"member {name}"
        if name in seen:
            raise InputError(path, field, "appears twice", _MEND)
        seen.add(name)
        if info.flag_bits & _ENCRYPTED:
            raise InputError(path, field, "is encrypted", _MEND)
        if info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
            raise InputError(path, field, "is compressed", _MEND)
        if info.file_size > limits.get(name, info.file_size):
            problem = f"has {info.file_size} bytes, more than {limits[name]}"
            raise InputError(path, field, problem, _MEND)
