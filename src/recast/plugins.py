"""Parts found by name: the built-in ones, and those of installed packages (entry points)."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from recast.errors import InputError

_OURS = __name__.partition(".")[0]
_SOURCES = (*SOURCE_SUFFIXES, *EXTENSION_SUFFIXES)
_INSTALLED = frozenset({"site-packages", "dist-packages"})


@dataclass(frozen=True)
class Registry:
    """One kind of exchangeable part.

    Attributes:
        kind: for messages, such as "planner".
        group: entry-point group in which other packages announce theirs.
        built_in: name to "module:attribute". Imported only when asked for.
    """

    kind: str
    group: str
    built_in: Mapping[str, str]

    def names(self) -> tuple[str, ...]:
        """All names, sorted."""
        return tuple(sorted({*self.built_in, *entry_points(group=self.group).names}))

    def load(self, name: str) -> Any:
        """The object of that name; "module:attribute" names any importable object.

        Raises:
            InputError: the name is unknown, or what it stands for cannot be imported. An exception
                of the module itself, `SystemExit` included, is the error's `__cause__`.
        """
        module, _, attribute = self._path(name).partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except (Exception, SystemExit) as error:
            raise InputError(
                self.kind, name, f"cannot be imported ({type(error).__name__}: {error})",
                "check the path and the installation",
            ) from error  # fmt: skip

    def source_files(self, name: str) -> tuple[Path, ...]:
        """The files of the code behind a name, see `source_files`; () if it is built in.

        Raises:
            InputError: the name is unknown.
        """
        return source_files(self._path(name))

    def _path(self, name: str) -> str:
        """The "module:attribute" of a name."""
        path = self.built_in.get(name, name)
        if ":" in path:
            return path
        plugins = entry_points(group=self.group)
        if name not in plugins.names:
            raise InputError(
                self.kind, name, "is not known",
                f"choose one of {', '.join(self.names())}, install its package, "
                "or give a path module:attribute",
            )  # fmt: skip
        return plugins[name].value


def source_files(name: str) -> tuple[Path, ...]:
    """The files of the code that "module:attribute" stands for: hash them to notice a change.

    Nothing is imported. Data files, such as weights that the code reads, are not among them.

    Returns:
        absolute paths, sorted: all Python files and extension modules of the module's top-level
        package, or the one file of a module without a package. If it is not installed but lies in
        a folder of the user's, also those of the modules in the same folder that it imports, and
        that these import. () for recast itself, and for a module that cannot be found.
    """
    top = name.partition(":")[0].partition(".")[0]
    found: dict[str, list[Path]] = {}
    wanted = {} if top == _OURS else {top: _places(top)}
    while wanted:
        module, places = wanted.popitem()
        found[module] = files = sorted(file for place in places for file in _files(place))
        folders = {place.parent for place in places}
        for imported in {name for file in files for name in _imports(file)}:
            beside = [place for folder in folders for place in _beside(folder, imported)]
            if beside and imported not in found and imported != _OURS:
                wanted[imported] = beside
    return tuple(sorted({file.resolve() for files in found.values() for file in files}))


def _places(top: str) -> list[Path]:
    """Folders of a top-level package, or the file of a module; empty if there is none."""
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):  # an empty name, or a module without a specification
        return []
    if spec is None:
        return []
    if spec.submodule_search_locations is not None:
        return [Path(place) for place in spec.submodule_search_locations]
    return [Path(spec.origin)] if spec.has_location and spec.origin else []


def _beside(folder: Path, module: str) -> list[Path]:
    """The file or folder of a top-level module in the user's own folder; empty if there is none."""
    if _INSTALLED.intersection(folder.parts):
        return []  # what lies beside are other distributions
    places = (folder / module, *(folder / f"{module}{suffix}" for suffix in _SOURCES))
    return [place for place in places if place.exists()][:1]


def _files(place: Path) -> Iterator[Path]:
    if place.is_file():
        yield place
    for folder, folders, names in os.walk(place):
        # Virtual environments and version control may lie in a namespace package.
        folders[:] = [name for name in folders if name[0] != "." and name not in _INSTALLED]
        yield from (Path(folder, name) for name in names if name.endswith(_SOURCES))


def _imports(file: Path) -> set[str]:
    """Top-level names that a Python file imports absolutely, anywhere in it."""
    if file.suffix not in SOURCE_SUFFIXES:
        return set()
    try:
        tree = ast.parse(file.read_bytes())
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return set()  # its import will say what is wrong
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.partition(".")[0])
    return names
