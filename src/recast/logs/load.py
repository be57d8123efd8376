"""Any driving log by one call: a log folder, here or in object storage, or a dataset's drive.

Log folders in object storage are copied once into a local cache, and read from there.
"""

from __future__ import annotations

import inspect
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from upath import UPath

from recast.core.arguments import checked
from recast.core.artefact import answering, cache_folder, digest, local_path, remote_path
from recast.core.diagnostics import Progress
from recast.core.errors import InputError
from recast.core.files import alone_in, atomic_folder, disk_errors, member
from recast.core.foreign import foreign_call
from recast.core.plugins import IMPORTERS
from recast.logs.plausibility import examined, require_plausible, warn_odd
from recast.logs.store import LOG_FILE, read_log
from recast.logs.types import DrivingLog

CopyProgress = Progress
"""Called with the bytes copied so far, and with all there are."""

_BLOCK = 1 << 23
"""Bytes that are copied at a time."""
_VERSIONS = ("ETag", "etag", "md5Hash", "content_md5", "LastModified", "mtime", "created")
"""What file systems call that which tells one version of a file from another, the best first."""


@checked()
def load_log(
    source: str | Path | UPath | DrivingLog,
    *,
    importer: str | Callable[..., DrivingLog] | None = None,
    drive: str | None = None,
    labels: str | Path | None = None,
    cameras: Sequence[str] = (),
    progress: CopyProgress | None = None,
    **options: Any,
) -> DrivingLog:
    """Load a driving log; its images and sweeps are decoded when asked for.

    Args:
        source: a log folder; or its address in object storage, such as "s3://bucket/folder" or a
            `UPath`, from where it is copied once (see `recast.logs.load.local_folder`); or the
            dataset's folder, with `importer`; or a log, which is returned as it is.
        importer: name of the dataset's importer, such as "kitti", "package.module:attribute", or a
            `LogImporter`. Nothing is written; see `write_log`.
        drive: the drive's name in the dataset; needed with `importer`, unless it reads a file of
            one drive, as "alpasim" does.
        labels: box labels that lie apart from the drive; only with `importer`.
        cameras: names of the cameras to import; the importer's default if empty; only with
            `importer`.
        progress: called with the bytes copied so far and with all there are.
        options: further ones of the importer, such as `refine` of "kitti".

    Returns:
        a valid log in recast's frames and units, see `DrivingLog`. Its `origin` is the folder it
        was read from, or None if it was imported.

    Raises:
        InputError: no such folder, address, importer, drive or option; the remote does not answer;
            files are missing or broken; or no vehicle can have recorded the log. The line names
            the file and the field.

    Warns:
        OddLogWarning: the log holds what a vehicle hardly does, such as boxes wider than long; see
            `recast.logs.plausibility`.

    >>> sorted(load_log(folder / "log").tracks)
    ['0', '1']
    """
    if importer is not None:
        given = {
            **({} if labels is None else {"labels": Path(labels)}),
            **({"cameras": tuple(cameras)} if cameras else {}),
            **options,
        }
        log = _imported(importer, source, drive, given)
        warn_odd(log)
        return log
    if drive is not None or labels is not None or cameras or options:
        problem = "is missing, but a drive or options of an importer are given"
        raise InputError(
            "load_log", "importer", problem, 'name an importer, such as importer="kitti"'
        )
    if isinstance(source, DrivingLog):
        log = source
        require_plausible(log, f"log {log.name}", "correct the data from which the log was made")
    else:
        log = read_log(local_folder(source, progress))
    warn_odd(log)
    return log


def _imported(
    importer: str | Callable[..., DrivingLog], root: Any, drive: str | None, given: dict[str, Any]
) -> DrivingLog:
    load: Callable[..., DrivingLog] = IMPORTERS.resolve(importer)
    name = importer if isinstance(importer, str) else getattr(importer, "__name__", "object")
    if not isinstance(root, str | os.PathLike) or "://" in os.fspath(root):
        shown = root if isinstance(root, str) else type(root).__name__
        raise InputError("importer", name, f"cannot read {shown}", "name a local folder")
    _check_call(name, load, drive, given)
    with foreign_call(f"importer {name}", os.fspath(root), load):
        log = load(Path(root), **given) if drive is None else load(Path(root), drive, **given)
    if not isinstance(log, DrivingLog):
        problem = f"returned {type(log).__name__} in place of a DrivingLog"
        raise InputError("importer", name, problem, "return the log; write_log writes it")
    return examined(log, Path(root))


def _check_call(
    name: str, load: Callable[..., DrivingLog], drive: str | None, given: Mapping[str, Any]
) -> None:
    """Refuse a missing drive, unless the importer has a default, and options that it lacks."""
    known: Mapping[str, inspect.Parameter] | None = None
    with suppress(TypeError, ValueError):  # made in C
        known = inspect.signature(load).parameters
    default = known["drive"].default if known and "drive" in known else inspect.Parameter.empty
    if drive is None and default is inspect.Parameter.empty:
        raise InputError("importer", name, "needs the name of a drive", "give the `drive`")
    if known is None or any(one.kind is inspect.Parameter.VAR_KEYWORD for one in known.values()):
        return
    for option in given:
        if option not in known:
            raise InputError("importer", name, f"has no option {option}", "leave it out")


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
                problem = f"{copied} bytes arrived, {file.size} were expected"
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
