"""Addresses elsewhere: what they answer, copies of them, and the depots of a store there."""

from __future__ import annotations

import hashlib
import io
import os
import tarfile
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, Protocol

from upath import UPath

from recast.core import files
from recast.core.artefact import DATA_FOLDER, RECORD_FILE, Artefact, ArtefactRecord, files_below
from recast.core.errors import InputError
from recast.core.names import member
from recast.core.records import parse_record

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


class Depot(Protocol):
    """Holds artefacts by reference, KIND/KEY."""

    def has(self, reference: str) -> bool:
        """Whether it holds a finished artefact."""

    def fetch(self, reference: str, folder: Path) -> None:
        """Copy an artefact, record and data, into a new folder.

        Raises:
            InputError: it is damaged, or nothing answers.
        """

    def push(self, reference: str, folder: Path) -> None:
        """Take an artefact over from its folder; the record last, which makes it finished.

        Raises:
            InputError: it is refused, or nothing answers.
        """


class FolderDepot:
    """A store's folder at an address that fsspec knows, such as s3://bucket/store.

    Two machines that make the same artefact at once both write the same files.
    """

    def __init__(self, root: UPath) -> None:
        self._root = root

    def has(self, reference: str) -> bool:
        """See `Depot`; an InputError where nothing answers."""
        record = self._root / reference / RECORD_FILE
        with self._answers():
            record.fs.invalidate_cache()  # another machine may have been here
            try:
                record.fs.info(record.path)  # is_file() says no where nothing answers
            except FileNotFoundError:
                return False
        return True

    def fetch(self, reference: str, folder: Path) -> None:
        """See `Depot`; names and sizes are checked before anything is taken."""
        where = self._root / reference
        with self._answers():
            text = (where / RECORD_FILE).read_bytes()
        value = files.parse_json(str(where / RECORD_FILE), text)
        mend = f"remove {where}, and it is made again"
        record = parse_record(str(where / RECORD_FILE), value, ArtefactRecord, 1, mend)
        for name, file in record.files.items():
            target = member(folder / DATA_FOLDER, name, str(where / RECORD_FILE), "files")
            source = where / DATA_FOLDER / name
            with self._answers():
                size = source.stat().st_size
            if size != file.size:
                problem = f"has {size} bytes, not {file.size}"
                raise InputError(str(source), "size", problem, mend)
            with files.disk_errors(target):
                target.parent.mkdir(parents=True, exist_ok=True)
                with self._answers():
                    source.fs.get_file(source.path, str(target))
        files.write_bytes(folder / RECORD_FILE, text)

    def push(self, reference: str, folder: Path) -> None:
        """See `Depot`."""
        where = self._root / reference
        record = folder / RECORD_FILE
        with self._answers():
            for path in (*files_below(folder / DATA_FOLDER), record):
                target = where / path.relative_to(folder).as_posix()
                target.parent.mkdir(parents=True, exist_ok=True)
                target.fs.put_file(str(path), target.path)

    def _answers(self) -> AbstractContextManager[None]:
        return answering(str(self._root), "storage")


def depot_of(place: str | os.PathLike[str]) -> tuple[Depot | None, Path]:
    """The depot at an address and the local folder that keeps its artefacts.

    Args:
        place: an address; for one of this machine the folder is the place itself, without a depot.

    Raises:
        InputError: no such kind of address, or its package is not installed.
    """
    root = remote_path(place)
    if root is None:
        return None, local_path(place)
    return FolderDepot(root), cache_folder("stores", digest(str(root)))


def pack(artefact: Artefact) -> bytes:
    """An artefact, record and data, as the bytes of a tar archive."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.add(artefact.folder, arcname=".")
    return buffer.getvalue()


def unpack(parcel: bytes, folder: Path) -> None:
    """Write what `pack` made into a folder; only plain files inside of it are taken.

    Raises:
        InputError: it is no such archive, or the disk refuses.
    """
    try:
        with tarfile.open(fileobj=io.BytesIO(parcel)) as archive, files.disk_errors(folder):
            archive.extractall(folder, filter="data")
    except tarfile.TarError as error:
        raise InputError(folder, "parcel", f"cannot be unpacked ({error})", "run again") from None


class Fetch(Protocol):
    """Gets the bytes that a parcel's ticket stands for."""

    def __call__(self, ticket: object, /) -> bytes:
        """Wait for them and return them."""


class ParcelDepot:
    """A `Depot` of parcels that came with a job.

    Args:
        tickets: tickets by reference; `fetch` turns a ticket into a parcel.
    """

    def __init__(self, tickets: Mapping[str, object], fetch: Fetch) -> None:
        self._tickets, self._fetch = dict(tickets), fetch

    def has(self, reference: str) -> bool:
        """Whether a parcel of it is there; see `Depot`."""
        return reference in self._tickets

    def fetch(self, reference: str, folder: Path) -> None:
        """Unpack its parcel; see `Depot`."""
        unpack(self._fetch(self._tickets[reference]), folder)

    def push(self, reference: str, folder: Path) -> None:
        """Nothing: what was made travels back with the outcome of the job."""
