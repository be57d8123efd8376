"""Files and folders that are there whole or not at all.

Everything is written to a temporary name beside its target and renamed, so that a crash, a kill or
a full disk never leaves something half-written under the final name.
"""

from __future__ import annotations

import errno
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from recast.errors import InputError


def _partial_name(path: Path) -> Path:
    # The same name every time, so that what a kill left behind is gone with the next write.
    return path.with_name(f".{path.name}.partial")


@contextmanager
def _full_disk_is_an_input_error(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise InputError(
                path, "disk", "no space left while writing", "free some space and run again"
            ) from error
        raise


@contextmanager
def atomic_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` on success, remove it on failure.

    What a killed write to `path` left behind is overwritten.

    Raises:
        InputError: the disk is full.
    """
    path = Path(path)
    partial = _partial_name(path)
    with _full_disk_is_an_input_error(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if partial.is_dir():  # a file is overwritten
                shutil.rmtree(partial)
            yield partial
            partial.replace(path)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Yield a fresh temporary folder beside `path`; rename it to `path` on success.

    On failure the temporary folder is removed, and what a killed write to `path` left behind
    before anything is written. An existing folder at `path` is never touched.

    Raises:
        InputError: `path` exists already, or the disk is full.
    """
    path = Path(path)
    if path.exists():
        raise InputError(path, "output folder", "exists already", "name another one or remove it")
    partial = _partial_name(path)
    with _full_disk_is_an_input_error(path):
        try:
            if partial.is_dir():
                shutil.rmtree(partial)
            partial.unlink(missing_ok=True)
            partial.mkdir(parents=True)
            yield partial
            partial.replace(path)
        except BaseException:
            shutil.rmtree(partial, ignore_errors=True)
            raise


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path`, whole or not at all."""
    with atomic_file(path) as partial:
        partial.write_bytes(data)


def write_text(path: str | Path, text: str) -> None:
    """Write `text` as UTF-8 to `path`, whole or not at all."""
    write_bytes(path, text.encode())


def write_json(path: str | Path, value: Any) -> None:
    """Write `value` as JSON with a stable layout (insertion order, two blanks, no NaN)."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def read_json(path: str | Path) -> Any:
    """Read a JSON file.

    Raises:
        InputError: the file is missing or is not JSON.
    """
    path = Path(path)
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        raise InputError(path, "file", "is missing", "check the path") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, "JSON", f"cannot be read ({error})", "write the file anew") from None
