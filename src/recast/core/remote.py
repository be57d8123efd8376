"""Addresses elsewhere: which they are, what they answer, and where copies of them are kept."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from upath import UPath

from recast.core.errors import InputError

CACHE_VARIABLE = "RECAST_CACHE"
"""Environment variable that names another cache folder than ~/.cache/recast."""
_LOCAL = ("", "file", "local")


def remote_path(place: Any) -> UPath | None:
    """The path of an address elsewhere, such as s3://bucket/folder; None for one of this machine.

    Args:
        place: text, path or `UPath`, which brings its own storage options.

    Raises:
        InputError: no such kind of address, or its package is not installed.
    """
    if isinstance(place, UPath):
        path = place
    elif isinstance(place, str) and "://" in place:
        with answering(place, "address"):
            path = UPath(place)
    else:
        return None
    with answering(str(place), "address"):
        return None if path.protocol in _LOCAL or not path.fs else path


def local_path(place: Any) -> Path:
    """A place of this machine as a path; `file://` addresses too."""
    return Path(UPath(place).path if "://" in str(place) else place)


def cache_folder(*parts: str) -> Path:
    """A folder of copies: below the one that RECAST_CACHE names, or ~/.cache/recast."""
    root = Path(os.environ.get(CACHE_VARIABLE) or "~/.cache/recast").expanduser()
    return root.joinpath(*parts)


def digest(text: str) -> str:
    """BLAKE2b-128 of a text, as hex: a folder's name for an address."""
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


@contextmanager
def answering(address: str, field: str) -> Iterator[None]:
    """Whatever a remote file system raises inside the block is one line."""
    try:
        yield
    except InputError:
        raise
    except ImportError as error:
        mend = "install the package; for s3://: pip install 'recast-sim[s3]'"
        raise InputError(address, field, str(error), mend) from error
    except Exception as error:  # each service has exceptions of its own
        problem = f"cannot be used ({type(error).__name__}: {error})"
        mend = "check the address, your credentials and the connection"
        raise InputError(address, field, problem, mend) from error
