"""Artefacts: on disk, their hashes and records; and elsewhere, as the depots of a store hold them.

What addresses elsewhere answer and copies of what lies there are here too.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import tarfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

from pydantic import Field, NonNegativeFloat, NonNegativeInt

from recast.core import files
from recast.core.errors import InputError
from recast.core.files import member
from recast.core.records import Record, parse_record, read_record

if TYPE_CHECKING:
    from upath import UPath

RECORD_FILE, DATA_FOLDER = "artefact.json", "data"
ARTEFACT_FORMAT: Literal["recast-artefact"] = "recast-artefact"
ARTEFACT_VERSION: Literal[1] = 1
KINDS = ("logs", "scenes", "actors", "evaluations", "rollouts")
"""Kinds of artefacts, in the order of the data's way."""
_REFERENCE = re.compile(rf"({'|'.join(KINDS)})/[0-9a-f]{{32}}")


def file_hash(path: str | Path) -> str:
    """BLAKE2b-128 of a file's bytes, as hex."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def folder_hash(folder: str | Path) -> str:
    """BLAKE2b-128 over the relative names and bytes of all files below a folder, in name order."""
    folder = Path(folder)
    return files_hash(files_below(folder), folder)


def files_below(folder: Path) -> list[Path]:
    """All files below a folder, in name order."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


def files_hash(files: Iterable[Path], root: Path) -> str:
    """BLAKE2b-128 over the names below `root` and the bytes of files, in the order given."""
    digest = hashlib.blake2b(digest_size=16)
    for path in files:
        name = path.relative_to(root).as_posix()
        digest.update(name.encode("utf-8", "surrogateescape") + b"\0")
        digest.update(bytes.fromhex(file_hash(path)))
    return digest.hexdigest()


def value_hash(value: Any) -> str:
    """BLAKE2b-128 of a JSON-able value, independent of key order."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


class FileRecord(Record):
    """A file of an artefact: bytes and their BLAKE2b-128."""

    size: NonNegativeInt
    hash: str


class ArtefactRecord(Record):
    """artefact.json."""

    format: Literal["recast-artefact"] = ARTEFACT_FORMAT
    version: Literal[1] = ARTEFACT_VERSION
    kind: str
    key: str
    name: str
    inputs: dict[str, Any]
    files: dict[str, FileRecord]
    seconds: NonNegativeFloat = Field(description="that making it took")
    recast: str = Field(description="version of the package that made it")


@dataclass(frozen=True)
class Artefact:
    """A finished artefact.

    Attributes:
        fresh: whether it was made just now, not found.
    """

    folder: Path
    record: ArtefactRecord
    fresh: bool = False

    @property
    def path(self) -> Path:
        """The folder of the data."""
        return self.folder / DATA_FOLDER

    @property
    def reference(self) -> str:
        """KIND/KEY: what stands for it in the inputs of others."""
        return f"{self.record.kind}/{self.record.key}"

    @property
    def size(self) -> int:
        """Bytes of the data."""
        return sum(file.size for file in self.record.files.values())


def artefact_key(kind: str, inputs: Mapping[str, Any]) -> str:
    """The key of an artefact: BLAKE2b-128 of all that it depends on, as 32 hexadecimal digits.

    Args:
        inputs: JSON-able: settings, content hashes, references of other artefacts, recipe version.
    """
    return value_hash({"kind": kind, "inputs": inputs})


def references(inputs: Any) -> Iterator[str]:
    """References of other artefacts that stand anywhere in an artefact's inputs."""
    if isinstance(inputs, Mapping):
        for value in inputs.values():
            yield from references(value)
    elif isinstance(inputs, list | tuple):
        for value in inputs:
            yield from references(value)
    elif isinstance(inputs, str) and _REFERENCE.fullmatch(inputs):
        yield inputs


def read_artefact(folder: Path) -> Artefact:
    """Read the record of a finished artefact; its files are not looked at.

    Raises:
        InputError: no record, a damaged one, or one of another version.
    """
    artefact = read_partial(folder)
    if artefact.reference != f"{folder.parent.name}/{folder.name}":
        problem = f"names {artefact.reference}"
        mend = f"remove {folder}, and it is made again"
        raise InputError(folder / RECORD_FILE, "key", problem, mend)
    return artefact


def read_partial(folder: Path) -> Artefact:
    """As `read_artefact`, of a folder that does not have its name yet."""
    mend = f"use the recast that wrote it, or remove {folder}, and it is made again"
    path = folder / RECORD_FILE
    record = read_record(path, ArtefactRecord, ARTEFACT_VERSION, mend, ARTEFACT_FORMAT)
    return Artefact(folder, record)


def written_files(data: Path) -> dict[str, FileRecord]:
    """The files below a folder, by relative name, with sizes and hashes."""
    return {
        path.relative_to(data).as_posix(): FileRecord(
            size=path.stat().st_size, hash=file_hash(path)
        )
        for path in files_below(data)
    }


def verify(artefact: Artefact) -> None:
    """Check that every file is there with the bytes that were written.

    Raises:
        InputError: names the first file at fault.
    """
    mend = f"remove {artefact.folder}, and it is made again"
    for name, file in artefact.record.files.items():
        path = member(artefact.path, name, artefact.folder / RECORD_FILE, "files")
        with files.disk_errors(path):
            if not path.is_file():
                raise InputError(path, "artefact", "this file was deleted", mend)
            if path.stat().st_size != file.size or file_hash(path) != file.hash:
                raise InputError(path, "bytes", "changed after the artefact was made", mend)


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
    from upath import UPath  # with fsspec: hashes do without

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
    from upath import UPath

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
