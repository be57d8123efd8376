"""Artefacts as bytes, to travel where no folder is shared."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from recast import storage
from recast.core.artefact import Artefact
from recast.errors import InputError


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
        with tarfile.open(fileobj=io.BytesIO(parcel)) as archive, storage.disk_errors(folder):
            archive.extractall(folder, filter="data")
    except tarfile.TarError as error:
        raise InputError(folder, "parcel", f"cannot be unpacked ({error})", "run again") from None


class Fetch(Protocol):
    """Gets the bytes that a parcel's ticket stands for."""

    def __call__(self, ticket: object, /) -> bytes:
        """Wait for them and return them."""


class ParcelDepot:
    """A `recast.core.depot.Depot` of parcels that came with a job.

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
