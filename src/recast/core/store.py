"""The store of artefacts, each made once and shared; its files: docs/runs.md#the-store."""

from __future__ import annotations

import logging
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from recast import __version__
from recast.core import files
from recast.core.artefact import (
    DATA_FOLDER,
    KINDS,
    RECORD_FILE,
    Artefact,
    ArtefactRecord,
    Depot,
    artefact_key,
    depot_of,
    read_artefact,
    read_partial,
    references,
    unpack,
    value_hash,
    verify,
    written_files,
)
from recast.core.errors import InputError
from recast.core.records import Record, read_record

_LOG = logging.getLogger(__name__)

STORE_FILE = "store.json"
STORE_FORMAT: Literal["recast-store"] = "recast-store"
STORE_VERSION: Literal[1] = 1
_USERS = "users"
_OF_THE_START = (STORE_FILE, files.partial_name(STORE_FILE).name)
"""What another process may be writing, or was when it was killed."""


class StoreRecord(Record):
    """store.json."""

    format: Literal["recast-store"] = STORE_FORMAT
    version: Literal[1] = STORE_VERSION


class UserRecord(Record):
    """users/HASH.json: a folder, relative to the store where it can be, and what it refers to."""

    version: Literal[1] = STORE_VERSION
    folder: str
    references: tuple[str, ...]


class NotInStoreError(LookupError):
    """An artefact that is to be found is not there."""


class Store:
    """Artefacts by kind and key.

    Several processes may use one store at once: who needs what another is making waits for it. A
    process that is killed leaves nothing that counts as finished, and its lock goes with it.

    Args:
        root: local folder; it comes into being with the first artefact.
        depot: depot that artefacts come from if they are not here, and go to when they are made.
        only_finds: make nothing: `make` raises `NotInStoreError`.

    Raises:
        InputError: the folder holds something else, or a store of a newer recast.
    """

    def __init__(
        self, root: str | Path, depot: Depot | None = None, only_finds: bool = False
    ) -> None:
        self.root, self.depot = Path(root).absolute(), depot
        self._only_finds = only_finds
        self._verified: dict[Path, int] = {}
        if (self.root / STORE_FILE).exists():
            mend = "use the recast that wrote it, or name another `store`"
            read_record(self.root / STORE_FILE, StoreRecord, STORE_VERSION, mend, STORE_FORMAT)
        elif self.root.exists() and not self.root.is_dir():
            raise InputError(self.root, "store", "is a file", "name a folder for `store`")
        elif self.root.exists() and any(
            one.name not in _OF_THE_START for one in self.root.iterdir()
        ):
            raise InputError(
                self.root,
                STORE_FILE,
                "is missing in a folder that is not empty",
                "name a store, or a new folder for `store`",
            )

    def find(self, kind: str, inputs: Mapping[str, Any]) -> Artefact | None:
        """The artefact that was made from these inputs, or None.

        Raises:
            InputError: its bytes changed, or see `read_artefact`.
        """
        return self._find(kind, artefact_key(kind, inputs))

    def open(self, reference: str) -> Artefact:
        """The artefact of a reference, KIND/KEY.

        Raises:
            InputError: it is not there, or see `find`.
        """
        kind, _, key = reference.partition("/")
        if next(references(reference), None) is None:
            raise InputError(
                reference,
                "reference",
                "is not the name of an artefact",
                f"give KIND/KEY, see {self.root}",
            )
        found = self._find(kind, key)
        if found is None:
            raise InputError(
                self.root, reference, "is not in the store", "run the command again to make it"
            )
        return found

    def make(
        self,
        kind: str,
        inputs: Mapping[str, Any],
        make: Callable[[Path], None],
        *,
        name: str,
        resumes: bool = False,
        waits: Callable[[], None] = lambda: None,
    ) -> Artefact:
        """The artefact of these inputs, made where it is not there yet.

        Args:
            inputs: all that it depends on, see `artefact_key`.
            resumes: whether `make` goes on with what an earlier try left in the folder.
            waits: called once if another process is making it.

        Raises:
            InputError: the disk refuses, or see `find`; and whatever `make` raises.
            NotInStoreError: the store only finds, and it is not there.
        """
        key = artefact_key(kind, inputs)
        found = self._find(kind, key)
        if found is None and self._only_finds:
            raise NotInStoreError(f"{kind}/{key}")
        if found is None:
            self._begin()
            with self._alone(kind, key, waits):
                found = self._find(kind, key)  # by the process that was waited for
                if found is None:
                    found = self._made(kind, key, inputs, make, name, resumes)
        self._push(found)
        return found

    def take(self, reference: str, parcel: bytes) -> Artefact:
        """Take over an artefact that another process packed, see `recast.core.artefact`.

        Raises:
            InputError: the parcel is damaged, or the disk refuses.
        """
        kind, _, key = reference.partition("/")
        self._begin()
        with self._alone(kind, key, lambda: None):
            if not (self.root / kind / key / RECORD_FILE).exists():
                partial = self._partial(kind, key)
                _clear(partial)
                unpack(parcel, partial)
                verify(read_partial(partial))
                self._commit(kind, key)
        taken = self.open(reference)
        self._push(taken)
        return taken

    def remove(self, artefact: Artefact) -> None:
        """Remove an artefact from this folder; from a depot nothing is removed."""
        with files.disk_errors(artefact.folder):
            self._verified.pop(artefact.folder, None)
            (artefact.folder / RECORD_FILE).unlink(missing_ok=True)  # first: a kill leaves no whole
            shutil.rmtree(artefact.folder, ignore_errors=True)

    def artefacts(self) -> Iterator[Artefact]:
        """All that are in this folder, by kind, then key; files are not looked at.

        Raises:
            InputError: a record is damaged or of another version.
        """
        for kind in KINDS:
            folder = self.root / kind
            for path in sorted(folder.iterdir()) if folder.is_dir() else ():
                if not path.name.startswith(".") and (path / RECORD_FILE).exists():
                    yield read_artefact(path)

    def refer(self, user: Path, names: Sequence[str]) -> None:
        """Note which artefacts a run folder refers to, so that `prune` leaves them."""
        self._begin()
        folder = os.path.relpath(user.absolute(), self.root)
        record = UserRecord(folder=folder, references=tuple(names))
        path = self.root / _USERS / f"{value_hash(folder)}.json"
        if (
            path.exists()
            and read_record(path, UserRecord, STORE_VERSION, "remove this file") == record
        ):
            return
        files.write_json(path, record.model_dump(mode="json"))

    def unused(self, older_than_s: float = 0.0) -> list[Artefact]:
        """What no run folder that is still there refers to, directly or through others.

        Args:
            older_than_s: seconds since an artefact was made. A run refers to its artefacts only
                when it is done, so younger ones may belong to one that is under way.

        Raises:
            InputError: see `artefacts`.
        """
        everything = {one.reference: one for one in self.artefacts()}
        wanted = [name for user in self.users().values() for name in user]
        kept: set[str] = set()
        while wanted:
            name = wanted.pop()
            if name in everything and name not in kept:
                kept.add(name)
                wanted.extend(references(everything[name].record.inputs))
        made_before = time.time() - older_than_s
        return [
            one
            for name, one in everything.items()
            if name not in kept and (one.folder / RECORD_FILE).stat().st_mtime <= made_before
        ]

    def users(self) -> dict[Path, tuple[str, ...]]:
        """Run folders that are still there, and the references of each."""
        folder = self.root / _USERS
        found = {}
        for path in sorted(folder.glob("*.json")) if folder.is_dir() else ():
            record = read_record(path, UserRecord, STORE_VERSION, "remove this file")
            user = Path(os.path.normpath(self.root / record.folder))
            with suppress(OSError):  # such as a name that no folder can have
                if user.is_dir():
                    found[user] = record.references
        return found

    def partial(self, kind: str) -> list[Path]:
        """Folders with the data of artefacts that are being made, or were when their process
        ended."""
        return [path / DATA_FOLDER for path in self._partials(kind)]

    def leftovers(self) -> list[Path]:
        """Partial folders that no process is at work on."""
        found = []
        for kind in KINDS:
            for path in self._partials(kind):
                key = path.name.removeprefix(".").removesuffix(".partial")
                with suppress(InputError), self._alone(kind, key, None):
                    found.append(path)
        return found

    def _find(self, kind: str, key: str) -> Artefact | None:
        folder = self.root / kind / key
        if not (folder / RECORD_FILE).exists():
            if self.depot is None or not self.depot.has(f"{kind}/{key}"):
                return None
            self._begin()
            with self._alone(kind, key, lambda: None):
                if not (folder / RECORD_FILE).exists():
                    self._fetch(kind, key)
        artefact = read_artefact(folder)
        stamp = (folder / RECORD_FILE).stat().st_mtime_ns
        if self._verified.get(folder) != stamp:
            verify(artefact)
            self._verified[folder] = stamp
        return artefact

    def _push(self, artefact: Artefact) -> None:
        if self.depot is not None and not self.depot.has(artefact.reference):
            self.depot.push(artefact.reference, artefact.folder)

    def _fetch(self, kind: str, key: str) -> None:
        assert self.depot is not None
        partial = self._partial(kind, key)
        _clear(partial)
        self.depot.fetch(f"{kind}/{key}", partial)
        verify(read_partial(partial))
        self._commit(kind, key)

    def _made(
        self,
        kind: str,
        key: str,
        inputs: Mapping[str, Any],
        make: Callable[[Path], None],
        name: str,
        resumes: bool,
    ) -> Artefact:
        partial = self._partial(kind, key)
        data = partial / DATA_FOLDER
        with files.disk_errors(partial):
            if not resumes:
                _clear(partial)
            data.mkdir(parents=True, exist_ok=True)
        _LOG.debug("%s/%s: begins (%s)", kind, key, name)
        began = time.monotonic()
        try:
            make(data)
        except BaseException:
            if not resumes:
                shutil.rmtree(partial, ignore_errors=True)
            raise
        seconds = time.monotonic() - began
        with files.disk_errors(partial):
            record = ArtefactRecord(
                kind=kind,
                key=key,
                name=name,
                inputs=dict(inputs),
                files=written_files(data),
                seconds=round(seconds, 2),
                recast=__version__,
            )
        files.write_json(partial / RECORD_FILE, record.model_dump(mode="json"))
        folder = self._commit(kind, key)
        self._verified[folder] = (folder / RECORD_FILE).stat().st_mtime_ns
        _LOG.debug("%s/%s: made in %.1f s", kind, key, seconds)
        return replace(read_artefact(folder), fresh=True)

    def _commit(self, kind: str, key: str) -> Path:
        folder = self.root / kind / key
        with files.disk_errors(folder):
            _clear(folder)  # one that was half deleted
            self._partial(kind, key).rename(folder)
        return folder

    def _partials(self, kind: str) -> list[Path]:
        return sorted((self.root / kind).glob(".*.partial"))

    def _partial(self, kind: str, key: str) -> Path:
        return self.root / kind / f".{key}.partial"

    def _begin(self) -> None:
        path = self.root / STORE_FILE
        if path.exists():
            return
        with files.disk_errors(self.root):
            self.root.mkdir(parents=True, exist_ok=True)
        with files.alone_in(self.root, wait=True):
            if not path.exists():
                files.write_json(path, StoreRecord().model_dump(mode="json"))

    @contextmanager
    def _alone(self, kind: str, key: str, waits: Callable[[], None] | None) -> Iterator[None]:
        """Keep other processes out; with `waits` None, an InputError if one is at work."""
        lock = self.root / kind / f".{key}.lock"
        with files.disk_errors(lock):
            lock.mkdir(parents=True, exist_ok=True)
        with ExitStack() as held:
            try:
                held.enter_context(files.alone_in(lock))
            except InputError:
                if waits is None:
                    raise
                waits()
                held.enter_context(files.alone_in(lock, wait=True))
            yield


def open_store(place: Any) -> Store:
    """The store at a place: a folder, or an address such as s3://bucket/store.

    Artefacts of a store elsewhere are kept in a folder of `recast.core.artefact.cache_folder` too.

    Raises:
        InputError: see `Store`; or nothing answers there.
    """
    if isinstance(place, Store):
        return place
    depot, local = depot_of(place)
    return Store(local, depot)


def _clear(folder: Path) -> None:
    with files.disk_errors(folder):
        if folder.exists():
            shutil.rmtree(folder)
