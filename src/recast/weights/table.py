"""The published weights that recast knows, where fetched ones lie, and the record beside them.

The entries themselves are in published.toml.
"""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, overload
from urllib.parse import quote

from pydantic import Field, NonNegativeInt

from recast.core import files
from recast.core.errors import InputError, nearest
from recast.core.files import member
from recast.core.records import Record, read_record

HUB = "https://huggingface.co"


@dataclass(frozen=True)
class Licence:
    """The terms of a file.

    Attributes:
        name: short name.
        link: address of the terms, or of the page that states them.
        restricted: whether they must be accepted before the first byte: non-commercial, gated, or
            not stated by the publisher.
    """

    name: str
    link: str
    restricted: bool = False


@dataclass(frozen=True)
class WeightsSource:
    """Files that lie in one place.

    Attributes:
        where: "owner/name" of a repository on Hugging Face, or the address of a web folder.
        files: names below it; in a repository also patterns with `*`.
        licence: licence of these files.
        revision: commit of the repository, 40 hexadecimal digits; None takes the main branch at the
            first `get` and keeps its commit in the record.
        sha256: SHA-256 of single files, by name.
        into: subfolder of the weights' folder.
    """

    where: str
    files: tuple[str, ...]
    licence: Licence
    revision: str | None = None
    sha256: Mapping[str, str] = field(default_factory=dict)
    into: str = ""

    @property
    def repository(self) -> bool:
        """Whether it is a repository on Hugging Face."""
        return "://" not in self.where

    @property
    def pinned(self) -> bool:
        """Whether the table fixes the bytes: by the commit, or by the hash of every file."""
        return self.revision is not None or set(self.files) <= set(self.sha256)

    def address(self, file: str, commit: str = "") -> str:
        """Where the publisher has a file, whichever mirror it is fetched from.

        Args:
            commit: commit, for a repository.
        """
        folder = f"{HUB}/{self.where}/resolve/{commit}" if self.repository else self.where
        return f"{folder}/{quote(file, safe='/+')}"


@dataclass(frozen=True)
class Weights:
    """An entry of the table.

    Attributes:
        use: what the networks are for.
        options: command-line options that take the name.
        part: kind of exchangeable part that it names, see `recast.core.plugins.Registry`; or empty.
        gigabytes: size of the download, rounded.
        sources: places where the files lie.
        opens: file or subfolder that stands for the name; the whole folder where empty.
        converter: "module:function" that is called with the folder after the download and writes
            what recast's reader takes.
        converted: downloaded files that are removed after that.
    """

    name: str
    use: str
    options: tuple[str, ...]
    gigabytes: float
    sources: tuple[WeightsSource, ...]
    part: str = ""
    opens: str = ""
    converter: str = ""
    converted: tuple[str, ...] = ()

    @property
    def licences(self) -> tuple[Licence, ...]:
        """The licences of all sources, each once."""
        return tuple(dict.fromkeys(source.licence for source in self.sources))

    @property
    def restricted(self) -> bool:
        """Whether terms must be accepted before the first byte."""
        return any(licence.restricted for licence in self.licences)

    @property
    def pinned(self) -> bool:
        """Whether the table fixes all bytes."""
        return all(source.pinned for source in self.sources)


def published(name: str) -> Weights:
    """The entry of a name.

    Raises:
        InputError: there is none.
    """
    if name not in PUBLISHED:
        known = ", ".join(PUBLISHED)
        raise InputError(
            "weights", name, "is not a name of published weights", f"give one of {known}"
        )
    return PUBLISHED[name]


def _read_table(path: Path) -> dict[str, Weights]:
    """The entries of published.toml by name.

    A source without a `link` has its licence on its own page; an entry names its sources, each
    with the subfolder that it is put into.
    """
    content = tomllib.loads(path.read_text("utf-8"))

    def source(key: str, into: str) -> WeightsSource:
        values = content["sources"][key]
        where = values["where"]
        link = values.get("link", f"{HUB}/{where}")
        licence = Licence(values["licence"], link, values.get("restricted", False))
        sha256 = values.get("sha256", {})
        files = tuple(values["files"])
        return WeightsSource(where, files, licence, values.get("revision"), sha256, into)

    return {
        name: Weights(
            name,
            entry["use"],
            tuple(entry["options"]),
            entry["gigabytes"],
            tuple(source(key, into) for key, into in entry["sources"].items()),
            entry.get("part", ""),
            entry.get("opens", ""),
            entry.get("converter", ""),
            tuple(entry.get("converted", ())),
        )
        for name, entry in content["weights"].items()
    }


PUBLISHED: Mapping[str, Weights] = _read_table(Path(__file__).with_name("published.toml"))
"""All entries by name."""


RECAST_WEIGHTS = "RECAST_WEIGHTS"
"""Environment variable that names another folder than weights/ in the cache of recast."""
RECORD_FILE = "weights.json"
_FORMAT: Literal["recast-weights"] = "recast-weights"

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


_PACKAGE = Path(__file__).parents[1]
_SHIPPED = {
    "recast-mini": (_PACKAGE / "trellis", ("--model",)),
    "recast-parametric": (_PACKAGE / "actors/parametric", ()),
    "gtrs-mini": (_PACKAGE / "planning", ("--start", "--driver")),
    "gtrs-mini-oracle": (_PACKAGE / "planning", ("--start", "--driver")),
    "gtrs-mini-replaced": (_PACKAGE / "planning", ("--start", "--driver")),
}
"""Networks that come with the package: name to the folder above and the options that take it."""


def shipped_folder(name: str) -> Path:
    """The folder of a network that comes with the package, such as "recast-mini"."""
    return _SHIPPED[name][0] / name


def weights_folder(*parts: str) -> Path:
    """The folder that holds fetched weights, each below its name."""
    named_folder = os.environ.get(RECAST_WEIGHTS)
    if named_folder:
        return Path(named_folder).expanduser().joinpath(*parts)
    from recast.core.artefact import cache_folder  # imports upath, in tens of milliseconds

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
    shipped = [name for name, (_, takers) in _SHIPPED.items() if option in takers]
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
