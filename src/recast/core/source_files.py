"""Which files hold the code of a "module:attribute": what a fingerprint of a user's code hashes."""

from __future__ import annotations

import ast
import importlib.util
import os
import sys
from collections.abc import Iterator
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES
from pathlib import Path

_OURS = __name__.partition(".")[0]
_SOURCES = (*SOURCE_SUFFIXES, *EXTENSION_SUFFIXES)
_INSTALLED = frozenset({"site-packages", "dist-packages"})


def search_folder(folder: str | None = None) -> None:
    """Let Python find the modules of a folder from now on, after those of all other places.

    Commands start from a script of the installation, so Python does not look into the present
    folder. `python -m` puts it first; here it comes last, so that a user's `random.py` replaces
    nothing that recast imports. As there, `python -P` and PYTHONSAFEPATH prevent it.

    Args:
        folder: absolute path; the present folder if None.
    """
    folder = os.getcwd() if folder is None else folder  # noqa: PTH109 (a text, as in sys.path)
    if not sys.flags.safe_path and folder not in sys.path:
        sys.path.append(folder)


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
    search_folder()
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
    names: set[str] = set()
    for statement in _statements(tree):
        if isinstance(statement, ast.Import):
            names.update(alias.name.partition(".")[0] for alias in statement.names)
        elif isinstance(statement, ast.ImportFrom) and statement.module and not statement.level:
            names.add(statement.module.partition(".")[0])
    return names


def _statements(tree: ast.Module) -> Iterator[ast.AST]:
    """All statements of a file. Expressions, most of `ast.walk`, hold none and are passed over."""
    pending: list[ast.AST] = list(tree.body)
    while pending:
        node = pending.pop()
        yield node
        for field in ("body", "orelse", "finalbody", "handlers", "cases"):
            pending += getattr(node, field, ())
