"""The NCore V4 stores of a log folder, opened.

The files are foreign: `ncore_check` says which may be opened, and what NCore and the libraries
below it raise for the rest becomes one line here.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

from ncore.data.v4 import SequenceComponentGroupsReader

from recast import names, storage
from recast.errors import InputError
from recast.logs.ncore_check import check_store
from recast.logs.ncore_write import SEQUENCE_FILE

Reader = TypeVar("Reader")
MEND = "import the drive again"


@contextmanager
def readable(path: Path, field: str) -> Iterator[None]:
    """Turn whatever goes wrong with a store's contents inside the block into one clear line."""
    try:
        yield
    except InputError:
        raise
    except (
        Exception
    ) as error:  # zarr, cbor, lzma, Blosc, numpy and NCore each raise their own kinds
        reason = str(error) or type(error).__name__
        raise InputError(path, field, f"cannot be read ({reason})", MEND) from error


@dataclass(frozen=True)
class NcoreFolder:
    """An NCore V4 store in a folder; cheap to copy into another process.

    Attributes:
        folder: holds ncore.json and the stores it lists.
    """

    folder: Path

    @property
    def listing(self) -> Path:
        """The file that names the stores."""
        return self.folder / SEQUENCE_FILE

    def check(self) -> None:
        """Open every store.

        Raises:
            InputError: ncore.json or a store it lists is missing or broken.
        """
        self._open()

    def has(self, kind: type[Any], name: str) -> bool:
        """Whether there is a component of this kind and instance name."""
        return name in _open_components(self._open(), cast(Hashable, kind))

    def component(self, kind: type[Reader], name: str) -> Reader:
        """The component reader of this kind and instance name.

        Raises:
            InputError: there is none.
        """
        field = f"{kind.__qualname__.split('.')[0]} {name!r}"
        with readable(self.listing, field):
            components = _open_components(self._open(), cast(Hashable, kind))
        if name not in components:
            raise InputError(self.listing, field, "is missing from the stores", MEND)
        return cast(Reader, components[name])

    def _open(self) -> SequenceComponentGroupsReader:
        with storage.disk_errors(self.listing):
            status = self.listing.stat()
        # Open files cannot be shared with a forked process, nor with a folder written anew.
        return _open(self.folder, os.getpid(), status.st_ino, status.st_mtime_ns)


@functools.lru_cache(maxsize=4)
def _open(folder: Path, pid: int, inode: int, changed: int) -> SequenceComponentGroupsReader:
    listing = folder / SEQUENCE_FILE
    field = "component_stores"
    with readable(listing, field):
        listed = [store["path"] for store in storage.read_json(listing)[field]]
    if not listed or not all(isinstance(name, str) for name in listed):
        raise InputError(listing, field, "names no files", MEND)
    if len(set(listed)) != len(listed):
        raise InputError(listing, field, "names a store twice", MEND)
    paths = [names.member(folder, name, listing, field) for name in listed]
    for path in paths:
        with readable(path, "NCore store"):
            check_store(path)
    with readable(listing, "NCore stores"):
        return SequenceComponentGroupsReader(paths, max_threads=1)


@functools.lru_cache(maxsize=64)
def _open_components(reader: SequenceComponentGroupsReader, kind: Hashable) -> dict[str, Any]:
    return dict(reader.open_component_readers(cast(Any, kind)))
