"""Files and folders that are there whole or not at all, and names from outside as names of files.

Everything is written to a temporary name beside its target and renamed, so that a crash, a kill or
a full disk never leaves something half-written under the final name. While it is written, the
temporary file or folder is locked; the lock ends with the process that holds it.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any, NoReturn

from recast.core.errors import InputError

try:
    import fcntl
except ImportError:  # not on Windows, where nothing is locked
    fcntl = None  # type: ignore[assignment]

_NO_LOCKS = {errno.EBADF, errno.EINVAL, errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP}
"""What file systems say that cannot lock this; NFS says the first of folders."""

JSON_LIMIT = 1 << 28
"""Bytes of a JSON file, at most."""

_DISK_FULL = ("disk", "no space left while writing", "free some space and run again")
_READ_ONLY = ("disk", "cannot be written to, it is read-only", "name a folder that can be written")
_FORBIDDEN = ("file", "permission denied", "check who owns it and its permissions")
_NO_FOLDER = ("file", "lies below something that is not a folder", "check the path")
_FAULTS = {
    errno.ENOSPC: _DISK_FULL,
    errno.EDQUOT: _DISK_FULL,
    errno.EFBIG: ("disk", "the file system takes no file of this size", "name another folder"),
    errno.EROFS: _READ_ONLY,
    errno.EACCES: _FORBIDDEN,
    errno.EPERM: _FORBIDDEN,
    errno.ENOENT: ("file", "is missing", "check the path"),
    errno.EISDIR: ("file", "is a folder", "check the path"),
    errno.ENOTDIR: _NO_FOLDER,
    errno.EEXIST: _NO_FOLDER,  # what mkdir says of a file among the parents
    errno.ENAMETOOLONG: ("file", "has too long a name", "choose a shorter name"),
    errno.ELOOP: ("file", "is a link that leads back to itself", "remove the link"),
    errno.EIO: ("disk", "failed (input/output error)", "check the disk"),
}


@contextmanager
def disk_errors(path: str | Path) -> Iterator[None]:
    """What the file system refuses inside of the block is one clear line.

    Args:
        path: the file or folder at fault, if the error names none or the temporary one beside it.

    Raises:
        InputError: no space, read-only, forbidden, missing, a folder in place of a file, and so on;
            or a path that cannot be one, in no or in this locale. Other errors pass.
    """
    try:
        yield
    except OSError as error:
        fault = _FAULTS.get(error.errno or 0)
        if fault is None:
            raise
        named = error.filename if isinstance(error.filename, str) else str(path)
        temporary = named.startswith(str(partial_name(path))) if Path(path).name else False
        raise InputError(path if temporary else named, *fault) from error
    except UnicodeEncodeError as error:
        if error.encoding == "utf-8":  # which every name can be written in
            raise
        problem = f"cannot be written in the encoding of the locale ({error.encoding})"
        raise InputError(error.object, "name", problem, "set LC_ALL=C.UTF-8") from error
    except ValueError as error:
        if isinstance(error, InputError) or "null" not in str(error):
            raise
        raise InputError(
            path, "file", "has a NUL character in its name", "check the name"
        ) from error


def partial_name(path: str | Path) -> Path:
    """The temporary name beside `path` of what is being written.

    The same every time, so that what a kill left behind is gone with the next write.
    """
    path = Path(path)
    return path.with_name(f".{path.name}.partial")


@contextmanager
def atomic_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` on success, remove it on failure.

    What a killed write to `path` left behind is overwritten.

    Raises:
        InputError: another process is writing it, or the disk refuses (see `disk_errors`).
    """
    path = Path(path)
    partial = partial_name(path)
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if partial.is_dir():  # a file is overwritten
            shutil.rmtree(partial)
        with _locked(os.open(partial, os.O_RDWR | os.O_CREAT, 0o666), path):
            try:
                yield partial
                partial.replace(path)
            except BaseException:
                with suppress(OSError):
                    partial.unlink(missing_ok=True)
                raise


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Yield a fresh temporary folder beside `path`; rename it to `path` on success.

    On failure the temporary folder is removed, and what a killed write to `path` left behind
    before anything is written. An existing folder at `path` is never touched.

    Raises:
        InputError: `path` exists already, another process is writing it, or the disk refuses (see
            `disk_errors`).
    """
    path = Path(path)
    with disk_errors(path):
        require_new(path)
        partial = partial_name(path)
        if not partial.is_dir():
            partial.unlink(missing_ok=True)
        partial.mkdir(parents=True, exist_ok=True)
        with _locked(os.open(partial, os.O_RDONLY), path):
            require_new(path)  # the process that held the lock may have finished it
            try:
                _clear(partial)
                yield partial
                partial.replace(path)
            except BaseException:
                shutil.rmtree(partial, ignore_errors=True)
                raise


def require_new(path: str | Path) -> None:
    """Refuse an output that is there already, before anything that takes long.

    Raises:
        InputError: `path` exists.
    """
    if Path(path).exists():
        raise InputError(
            path, "output folder", "exists already", "name another folder or remove this one"
        )


def _clear(folder: Path) -> None:
    for entry in folder.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()


@contextmanager
def alone_in(folder: str | Path, wait: bool = False) -> Iterator[None]:
    """Keep other processes that ask for the same folder out until the block ends.

    Args:
        wait: until another process is done with it, instead of raising.

    Raises:
        InputError: another process is at work there, or the folder cannot be opened.
    """
    with disk_errors(folder):
        handle = os.open(folder, os.O_RDONLY)
    with _locked(handle, Path(folder), wait):
        yield


@contextmanager
def _locked(handle: int, what: Path, wait: bool = False) -> Iterator[None]:
    """Lock an open file or folder; close it at the end, which unlocks."""
    try:
        if fcntl is not None:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                raise InputError(
                    what,
                    "lock",
                    "another process is at work here",
                    "wait until it is done, or name another output folder",
                ) from None
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
        yield
    finally:
        os.close(handle)


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path`, whole or not at all."""
    with atomic_file(path) as partial:
        partial.write_bytes(data)


def write_text(path: str | Path, text: str) -> None:
    """Write `text` as UTF-8 to `path`, whole or not at all; half a character is escaped."""
    write_bytes(path, text.encode(errors="backslashreplace"))


def write_json(path: str | Path, value: Any) -> None:
    """Write `value` as JSON with a stable layout (insertion order, two blanks, no NaN)."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def read_bytes(path: str | Path, limit: int) -> bytes:
    """All of a file.

    Raises:
        InputError: no file, or not to be read, or of more than `limit` bytes.
    """
    path = Path(path)
    with disk_errors(path):
        size = path.stat().st_size
        if size <= limit:
            with path.open("rb") as stream:
                # As much memory is taken as is asked for: the size, not the limit, unless a file
                # has more than it says, as a device does, which says 0 and never ends.
                data = stream.read(size + 1)
                if len(data) > size:
                    data += stream.read(limit + 1 - len(data))
            size = max(size, len(data))
        if size > limit:
            problem = f"has {size} bytes, {limit} are read at most"
            raise InputError(path, "size", problem, "check that it is the right file")
        return data


_KINDS = {
    b"PK\x03\x04": "a zip archive",
    b"\x1f\x8b\x08": "a gzip archive",
    b"BZh": "a bzip2 archive",
    b"\xfd7zXZ": "an xz archive",
    b"7z\xbc\xaf": "a 7-Zip archive",
    b"(\xb5/\xfd": "a Zstandard archive",
    b"PAR1": "a parquet file",
    b"ARROW1": "a feather file (Arrow)",
    b"FEA1": "a feather file of version 1",
    b"\x93NUMPY": "a numpy array",
    b"\x89HDF": "an HDF5 file",
    b"SQLite format 3": "an SQLite database",
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"%PDF": "a PDF document",
    b"version https://git-lfs": "a pointer of Git LFS (git lfs pull downloads the file itself)",
    b"<!doctype html": "a web page",
    b"<html": "a web page",
    b"<?xml": "an XML document",
}
"""What files are that begin so, in lower case where they begin with text."""


def kind_of_file(data: bytes) -> str:
    """What a file is that is not what was asked for, such as "a zip archive"; empty if unknown.

    Downloads give error pages, pointers and archives in place of files.
    """
    if not data:
        return "empty"
    if data[257:262] == b"ustar":
        return "a tar archive"
    text = data[:64].removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    for magic, kind in _KINDS.items():
        if data.startswith(magic) or text.startswith(magic):
            return kind
    return ""


def read_text(path: str | Path, limit: int = JSON_LIMIT) -> str:
    """All of a UTF-8 text file, without a byte order mark.

    Raises:
        InputError: see `read_bytes`; or not UTF-8.
    """
    data = read_bytes(path, limit)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        kind = kind_of_file(data)
        problem = f"is not UTF-8 (byte {error.start})" + (f": the file is {kind}" if kind else "")
        raise InputError(path, "text", problem, "save it as UTF-8") from None


def read_json(path: str | Path) -> Any:
    """Read a JSON file; see `read_bytes` and `parse_json` for what is refused."""
    return parse_json(path, read_bytes(path, JSON_LIMIT))


def parse_json(where: str | Path, data: str | bytes) -> Any:
    """What JSON text stands for; `where` it was read from is for messages.

    Raises:
        InputError: not UTF-8, not JSON, nested too deeply, or with a number that is not finite
            or has thousands of digits.
    """
    mend = "write the file again"
    try:
        text = data.decode("utf-8-sig") if isinstance(data, bytes) else data
        return json.loads(text, parse_float=_finite, parse_constant=_refused)
    except RecursionError:
        raise InputError(where, "JSON", "is nested too deeply", mend) from None
    except ValueError as error:  # of the parser, of UTF-8, or of a number
        reason = str(error).split("; use sys")[0]
        kind = kind_of_file(data.encode(errors="replace") if isinstance(data, str) else data)
        reason += f"; it is {kind}" if kind else ""
        raise InputError(where, "JSON", f"cannot be read ({reason})", mend) from None


def _finite(text: str) -> float:
    value = float(text)
    if value in (float("inf"), float("-inf")):
        raise ValueError(f"{text[:20]} is too large a number")
    return value


def _refused(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a number that JSON allows")


_PLAIN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,99}")
_RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?")  # device names on Windows


def folder_name(name: str) -> str:
    """One path component for any name, the same each time; different names get different ones.

    Up to 100 letters, digits, `_ . + -` that do not begin with a dot or a dash stay as they are.
    Any other name gets its readable part and a hash, with `~` between, which plain names lack.
    """
    plain = _PLAIN.fullmatch(name) and not name.endswith(".") and not _RESERVED.fullmatch(name)
    if plain:
        return name
    readable = re.sub(r"[^A-Za-z0-9_-]+", "_", name)[:40].strip("_-") or "name"
    digest = hashlib.blake2b(name.encode("utf-8", "surrogatepass"), digest_size=8)
    return f"{readable}~{digest.hexdigest()}"


def member(folder: str | Path, name: str, where: str | Path, field: str) -> Path:
    """The path that a record names inside of `folder`.

    Links inside of the folder are followed: caches of downloaded files consist of them.

    Args:
        name: relative path, with `/` between components.
        where, field: record and member that name it, for messages.

    Raises:
        InputError: the name is empty, absolute, leads out of the folder or contains a NUL, a
            backslash or a character that no file name here can have, such as a lone surrogate.
    """
    path = PurePosixPath(name)
    wrong = not path.parts or path.is_absolute() or ".." in path.parts or len(name) > 4096
    wrong |= "\0" in name or "\\" in name or (len(name) > 1 and name[1] == ":")
    if wrong or not _is_file_name(name):
        raise InputError(
            where,
            field,
            f"names {name!r}, which is not a file inside of {Path(folder).name}/",
            "give a relative path below that folder",
        )
    return Path(folder) / path


def _is_file_name(name: str) -> bool:
    try:
        os.fsencode(name)
    except UnicodeEncodeError:
        return False
    return True
