"""Log folders in object storage: copied once into a local cache, and read from there."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from upath import UPath

from recast.core.remote import answering, cache_folder, digest, local_path, remote_path
from recast.errors import InputError
from recast.logs.store import LOG_FILE
from recast.names import member
from recast.storage import alone_in, atomic_folder, disk_errors

CopyProgress = Callable[[int, int], None]
"""Called with the bytes copied so far, and with all there are."""

_BLOCK = 1 << 23
"""Bytes that are copied at a time."""
_VERSIONS = ("ETag", "etag", "md5Hash", "content_md5", "LastModified", "mtime", "created")
"""What file systems call that which tells one version of a file from another, the best first."""


def local_folder(address: str | Path | UPath, progress: CopyProgress | None = None) -> Path:
    """The folder of a log on this machine: the folder itself, or a copy of a remote one.

    The files at the address are listed every time. Where the cache has no copy of exactly these
    files (names, sizes, versions), they are copied to `logs/<hash of the address>/<hash of the
    list>` in `cache_folder()`. The copy appears whole or not at all and is never changed, so a log
    that was read from an older copy stays readable. Processes that want the same copy wait for the
    one that makes it.

    Args:
        address: a local path, or what universal-pathlib knows, such as "s3://bucket/folder". A
            `UPath` brings its own storage options.
        progress: called after each block, and once before the first.

    Raises:
        InputError: an unknown kind of address, or its package is missing; the remote does not
            answer, or has no log.json there; a file arrived with another size; the disk refuses.
    """
    remote = remote_path(address)
    if remote is None:
        return local_path(address)
    found = _Remote(str(remote).rstrip("/"), remote.fs, remote.path.rstrip("/"))
    files = found.list_files()
    if LOG_FILE not in files:
        mend = "name a folder that recast log import wrote"
        raise InputError(found.address, LOG_FILE, "is missing", mend)
    listed = json.dumps({name: [one.size, one.version] for name, one in files.items()})
    shelf = cache_folder("logs", digest(found.address))
    copy = shelf / digest(listed)
    with disk_errors(shelf):
        shelf.mkdir(parents=True, exist_ok=True)
    with alone_in(shelf, wait=True):
        if not copy.is_dir():
            with atomic_folder(copy) as folder:
                found.copy(files, folder, progress)
    return copy


@dataclass(frozen=True)
class _File:
    """A remote file: its path there, size in bytes, and version (empty if it has none)."""

    path: str
    size: int
    version: str


@dataclass(frozen=True)
class _Remote:
    """A remote folder: its address for messages, its file system, and its path there."""

    address: str
    system: Any
    path: str

    def list_files(self) -> dict[str, _File]:
        """All files below the folder by relative name, sorted."""
        with answering(self.address, "files"):
            self.system.invalidate_cache()
            found = self.system.find(self.path, detail=True)
        files = {}
        for path, about in found.items():
            if about.get("type", "file") == "file" and path.startswith(self.path + "/"):
                version = next((str(about[key]) for key in _VERSIONS if about.get(key)), "")
                name = PurePosixPath(path.removeprefix(self.path + "/")).as_posix()
                files[name] = _File(path, int(about.get("size") or 0), version)
        return dict(sorted(files.items()))

    def copy(
        self, files: dict[str, _File], folder: Path, progress: CopyProgress | None = None
    ) -> None:
        """Copy the files into a local folder, one at a time; checks their sizes."""
        done, total = 0, sum(file.size for file in files.values())
        if progress is not None:
            progress(done, total)
        for name, file in files.items():
            target = member(folder, name, self.address, "file name")
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("wb") as out:
                for block in self._blocks(name, file):
                    out.write(block)
                    done += len(block)
                    if progress is not None:
                        progress(done, total)
                copied = out.tell()
            if copied != file.size:
                problem = f"{copied} bytes arrived, {file.size} were announced"
                raise InputError(self.address, name, problem, "load it again")

    def _blocks(self, name: str, file: _File) -> Iterator[bytes]:
        with answering(self.address, name):
            stream = self.system.open(file.path, "rb")
        with stream:
            while True:
                with answering(self.address, name):
                    block = stream.read(_BLOCK)
                if not block:
                    return
                yield block
