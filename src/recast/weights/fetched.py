"""Where fetched weights lie, what a name stands for, and the record beside them."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal, overload

from pydantic import Field, NonNegativeInt

from recast.core import files
from recast.core.errors import InputError, nearest
from recast.core.names import member
from recast.core.records import Record, read_record
from recast.weights.table import PUBLISHED, Weights

RECAST_WEIGHTS = "RECAST_WEIGHTS"
"""Environment variable that names another folder than weights/ in the cache of recast."""
RECORD_FILE = "weights.json"
_FORMAT: Literal["recast-weights"] = "recast-weights"

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


_PACKAGE = Path(__file__).parents[1]
_SHIPPED = {
    "recast-mini": (_PACKAGE / "trellis", "--model"),
    "gtrs-mini": (_PACKAGE / "planning", "--start"),
    "gtrs-mini-oracle": (_PACKAGE / "planning", "--start"),
}
"""Networks that come with the package: name to the folder above and the option that takes it."""


def shipped_folder(name: str) -> Path:
    """The folder of a network that comes with the package, such as "recast-mini"."""
    return _SHIPPED[name][0] / name


def weights_folder(*parts: str) -> Path:
    """The folder that holds fetched weights, each below its name."""
    named_folder = os.environ.get(RECAST_WEIGHTS)
    if named_folder:
        return Path(named_folder).expanduser().joinpath(*parts)
    from recast.core.remote import cache_folder  # imports upath, in tens of milliseconds

    return cache_folder("weights", *parts)


def place(part: str, name: str) -> Path | None:
    """The folder or file that a name of published weights stands for, checked before it is used.

    None if it is no name of weights for that `part`, such as "generator", see `Weights.part`.

    Raises:
        InputError: they were not fetched, changed on disk, or are not those that the table pins.
    """
    weights = PUBLISHED.get(name)
    return opened(weights) if weights is not None and part == weights.part else None


@overload
def located(option: str, value: Path) -> Path: ...


@overload
def located(option: str, value: Path | None) -> Path | None: ...


def located(option: str, value: Path | None) -> Path | None:
    """What the value of an option that takes a path stands for.

    Args:
        option: option such as "--model"; it decides which names are valid.
        value: a path, which is given back if it exists; or the name of published weights or of a
            network that comes with the package.

    Raises:
        InputError: `value` is none of these, or see `place`.
    """
    if value is None or value.exists():
        return value
    name = str(value)
    shipped = [name for name, (_, taker) in _SHIPPED.items() if taker == option]
    if name in shipped:
        return shipped_folder(name)
    names = [*shipped, *(name for name, entry in PUBLISHED.items() if option in entry.options)]
    if name in names:
        return opened(PUBLISHED[name])
    near = nearest(name, names)
    hint = f"did you mean {near}?" if near else f"give a path, or {' or '.join(names)}"
    raise InputError(option, name, "does not exist", hint)


def opened(weights: Weights) -> Path:
    """The folder or file of fetched weights.

    Raises:
        InputError: see `place`.
    """
    folder = weights_folder(weights.name)
    get = f"run `recast weights get {weights.name}`"
    if not (folder / RECORD_FILE).is_file():
        raise InputError("weights", weights.name, "are not downloaded", get)
    record = read_weights_record(folder)
    if not record.is_of(weights):
        problem = "have another version than this recast expects"
        raise InputError("weights", weights.name, problem, get)
    verify(folder, record, every_byte=False)
    return folder / weights.opens if weights.opens else folder


def is_fetched(name: str) -> bool:
    """Whether weights are here; their bytes are not looked at."""
    return (weights_folder(name) / RECORD_FILE).is_file()


class FetchedFile(Record):
    """Size and hash of a file."""

    size: NonNegativeInt
    sha256: Sha256


class WeightsRecord(Record):
    """weights.json; the same on every machine, whichever mirror the bytes came from.

    Attributes:
        name: name in the table.
        revisions: repository on Hugging Face to the commit that was downloaded.
        fetched: what came over the network, by its address at the publisher.
        converter: code that made `files` of it; empty if they are the same.
        files: all files of the folder but this one, by relative name.
    """

    format: Literal["recast-weights"] = _FORMAT
    version: Literal[1] = 1
    name: str
    revisions: dict[str, str]
    fetched: dict[str, FetchedFile]
    converter: str = ""
    files: dict[str, FetchedFile]

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files.values())

    def is_of(self, weights: Weights) -> bool:
        """Whether what was downloaded is all of an entry, and what it pins."""
        for source in weights.sources:
            commit = self.revisions.get(source.where, "")
            if source.revision not in (None, commit):
                return False
            for name in source.files:
                file = self.fetched.get(source.address(name, commit))
                if file is None and "*" not in name:
                    return False
                if file is not None and source.sha256.get(name, file.sha256) != file.sha256:
                    return False
        return True


def read_weights_record(folder: Path) -> WeightsRecord:
    """Read the record of fetched weights.

    Raises:
        InputError: there is none, or it is damaged or of another version.
    """
    return read_record(folder / RECORD_FILE, WeightsRecord, 1, _mend(folder), _FORMAT)


def file_record(path: Path) -> FetchedFile:
    """Size and SHA-256 of a file, all of it read."""
    with path.open("rb") as stream:
        sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
    return FetchedFile(size=path.stat().st_size, sha256=sha256)


def verify(folder: Path, record: WeightsRecord, every_byte: bool = True) -> None:
    """Check that every file is there with the bytes that were fetched.

    Args:
        every_byte: read all files. If False, a file that the file system has not changed since it
            was last read (size, inode, times of change and modification) is not read again.

    Raises:
        InputError: names the first file at fault.
    """
    seen, read = {} if every_byte else _read_stamps(folder), False
    for name, file in record.files.items():
        path = member(folder, name, folder / RECORD_FILE, "files")
        with files.disk_errors(path):
            if not path.is_file():
                raise InputError(path, "weights", "this file is missing", _mend(folder))
            if path.stat().st_size == file.size and seen.get(name) == _stamp(path):
                continue
            read = True
            if file_record(path) != file:
                problem = f"changed after {record.name} was downloaded"
                raise InputError(path, "bytes", problem, _mend(folder))
    if read:
        remember(folder, record)


def remember(folder: Path, record: WeightsRecord) -> None:
    """Note, beside a folder whose files were all read, how the file system describes them."""
    with suppress(InputError, OSError):  # somebody else's folder: read again the next time then
        stamps = {name: _stamp(folder / name) for name in record.files}
        files.write_json(_note(folder), stamps)


def written_files(
    folder: Path, leave: Collection[str], known: Mapping[str, FetchedFile]
) -> dict[str, FetchedFile]:
    """The files below a folder by relative name, but those to `leave`; `known` were read already.

    Names that begin with a dot are temporary.
    """
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        temporary = any(part.startswith(".") for part in name.split("/"))
        if path.is_file() and not temporary and name not in leave:
            found[name] = known.get(name) or file_record(path)
    return found


def _stamp(path: Path) -> list[int]:
    # The time of change cannot be set back by a program, unlike that of modification.
    stat = path.stat()
    return [stat.st_size, stat.st_ino, stat.st_mtime_ns, stat.st_ctime_ns]


def _note(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.verified.json")


def _read_stamps(folder: Path) -> dict[str, Any]:
    with suppress(InputError):
        found = files.read_json(_note(folder))
        return found if isinstance(found, dict) else {}
    return {}


def _mend(folder: Path) -> str:
    return f"remove {folder}, then: recast weights get {folder.name}"
