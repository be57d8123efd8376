"""Where a store gets artefacts from that lie elsewhere: object storage, machines, parcels."""

from __future__ import annotations

import io
import os
import tarfile
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from upath import UPath

from recast.core import files
from recast.core.artefact import DATA_FOLDER, RECORD_FILE, Artefact, ArtefactRecord
from recast.core.errors import InputError
from recast.core.names import member
from recast.core.records import parse_record
from recast.core.remote import answering, cache_folder, digest, local_path, remote_path


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
        data = sorted(path for path in (folder / DATA_FOLDER).rglob("*") if path.is_file())
        with self._answers():
            for path in (*data, record):
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
        tickets: by reference, what `fetch` turns into a parcel.
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
