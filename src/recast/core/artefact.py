"""One artefact on disk: content hashes, its record, and whether its bytes are still the same."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt

from recast.core import files
from recast.core.errors import InputError
from recast.core.names import member
from recast.core.records import Record, read_record

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
