"""The published weights that recast knows: where they lie, under which licence, and their pins.

The entries themselves are in published.toml.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

from recast.core.errors import InputError

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
