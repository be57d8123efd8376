"""Exchangeable parts, found by name, by folder or file, or by the path of their code.

All names are entry points: those of recast itself stand in its pyproject.toml, as those of every
other package do. No module here or below imports a part.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES
from pathlib import Path
from typing import TYPE_CHECKING, Any

from recast.core.errors import InputError, nearest

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints


INSTALLED_BY: Mapping[str, str] = {
    "recast-bridges": "pip install 'recast-sim[bridges]'",
    "recast-tools": "make setup in a clone of the repository",
}
"""The project's other distributions, and the command that installs each."""
_OWN = frozenset({"recast", *(name.replace("-", "_") for name in INSTALLED_BY)})
"""Packages of the project, which leave torch's settings alone."""
_BRIDGED: Mapping[str, tuple[str, ...]] = {
    "importer": ("alpasim", "drivestudio", "py123d", "street-gaussians"),
    "planner": ("alpasim:", "navsim:", "neuroncap:"),
    "restorer": ("harmonizer:",),
}
"""Names by kind of part that the bridges have, for the hint when they are not installed."""


def entry_points(group: str) -> EntryPoints:
    """The entry points of all installed packages in a group."""
    return _installed(tuple(sys.path)).select(group=group)


@lru_cache(maxsize=4)
def _installed(_path: tuple[str, ...]) -> EntryPoints:
    """All entry points, by the folders that Python searches: reading them takes 10 ms."""
    from importlib.metadata import EntryPoints, distributions

    first = {one.name: one for one in reversed(list(distributions()))}  # as Python would import it
    return EntryPoints(entry for one in first.values() for entry in one.entry_points)


def splat_formats() -> tuple[str, ...]:
    """Names of the formats of Gaussians, see `recast.splats.formats`: ply and gltf, then sorted."""
    own = ("ply", "gltf")
    return (*own, *sorted({*entry_points("recast.splat_formats").names}.difference(own)))


@dataclass(frozen=True)
class Registry:
    """One kind of exchangeable part, and every way to name one; see `resolve`.

    Its code is given as "module:attribute" and imported only when it is needed.

    Attributes:
        group: entry-point group of the names. Groups that begin with it have the rest: `.folder`
            (one entry: code that reads a part from a folder, called with its path), `.files`
            (suffix of a file's name without the dot: code that reads such a file), `.prefixes`
            (start of a name without its colon: code that is called with what follows),
            `.sources` (the same start: code that returns what stands for such a part in keys of
            artefacts, where the name alone is not enough) and `.experimental` (names of parts that
            have not met real data).
        members: attributes that tell an object of the kind from other objects.
        protocol: full name of the protocol that documents these members, for messages.
        makes_parts: whether code is a class or function that returns the part when called; if
            False, it is the part.
    """

    kind: str
    group: str
    members: tuple[str, ...] = ()
    protocol: str = ""
    makes_parts: bool = True

    @property
    def folder(self) -> str:
        """Code that reads a part from a folder; empty if there is none."""
        return next((entry.value for entry in entry_points(f"{self.group}.folder")), "")

    @property
    def files(self) -> Mapping[str, str]:
        """Code by suffix of a file's name, in lower case."""
        return {f".{one.name}": one.value for one in entry_points(f"{self.group}.files")}

    @property
    def prefixes(self) -> Mapping[str, str]:
        """Code by start of a name, such as "library:"."""
        return {f"{one.name}:": one.value for one in entry_points(f"{self.group}.prefixes")}

    @property
    def experimental(self) -> frozenset[str]:
        """Names of parts that have not met real data."""
        return frozenset(entry_points(f"{self.group}.experimental").names)

    def names(self) -> tuple[str, ...]:
        """All names, sorted."""
        return tuple(sorted(entry_points(self.group).names))

    def labels(self) -> tuple[str, ...]:
        """All names, sorted, those of experimental parts marked."""
        mark = {name: f"{name} (experimental)" for name in self.experimental}
        return tuple(mark.get(name, name) for name in self.names())

    def resolve(self, value: Any, **options: Any) -> Any:
        """The part that a value stands for.

        Args:
            value: the first of these that fits: an object of the kind, which is returned as it is;
                a text with a prefix of the kind; a name, built in or of an installed package; a
                name of fetched weights for the kind, see `recast.weights`; a folder or a file, if
                the kind reads some (`./NAME` for one that is called like a part or weights);
                "package.module:attribute".
            options: given to the code that makes the part, each only if it has a parameter of that
                name; see `takes`.

        Raises:
            InputError: the value is none of these; its code cannot be imported, raises an
                exception, which is then the error's `__cause__`, or makes an object that lacks a
                member of the kind.
        """
        if not isinstance(value, str | os.PathLike):
            return self._checked(value, type(value).__name__, "is")
        from recast.core.foreign import place_of, process_kept  # here, as it needs numpy

        try:
            with process_kept(seed=0):
                part = _called(self._code(value), options)
        except (InputError, KeyboardInterrupt):
            raise
        except BaseException as error:  # of the user's code, which may also end the program
            raise InputError(
                self.kind,
                os.fspath(value),
                f"cannot be made ({type(error).__name__}: {error}{place_of(error)})",
                "name a class or function that works when called without arguments",
            ) from error
        return self._checked(part, os.fspath(value), "made")

    def takes(self, value: Any, option: str) -> bool:
        """Whether `resolve` would pass the option on; False for an object.

        Raises:
            InputError: the value is unknown, or its code cannot be imported.
        """
        named = isinstance(value, str | os.PathLike)
        return named and option in _parameters(self._code(value))

    def place(self, value: str | os.PathLike[str]) -> Path | None:
        """The folder or file that `resolve` would read, or None if code makes the part.

        It need not exist: a path object or a text with a slash is always taken for a path.

        Raises:
            InputError: the name of published weights that were not fetched, or changed.
        """
        text = os.fspath(value)
        if isinstance(value, str) and (
            text.startswith(tuple(self.prefixes)) or text in self.names()
        ):
            return None
        if isinstance(value, str) and (weights := self._weights(text)):
            return weights
        path = Path(text)
        if path.suffix.lower() in self.files:
            return path
        is_path = not isinstance(value, str) or "/" in text or os.sep in text or path.is_dir()
        return path if self.folder and text and is_path else None

    def make(self, name: str, **options: Any) -> Any:
        """Call the code behind a name with those of the options that it takes.

        Raises:
            InputError: see `load`; or the code is no class or function. Its own exceptions pass.
        """
        return _called(self._callable(name), options)

    def load(self, name: str) -> Any:
        """The code behind a name, or behind "module:attribute".

        Raises:
            InputError: the name is unknown, or its code cannot be imported. An exception of the
                module itself, an exit included, is the error's `__cause__`.
        """
        return self._imported(self._path(name), name)

    def source_files(self, name: str) -> tuple[Path, ...]:
        """The files of the code behind a name, see `source_files`; () if it is of recast.

        Raises:
            InputError: the name is unknown.
        """
        return source_files(self._path(name))

    def is_own(self, name: str) -> bool:
        """Whether a name is that of a part of recast's own."""
        return name in self.names() and not self.source_files(name)

    def source(self, name: str) -> str:
        """What stands for a part in keys of artefacts.

        A part of recast is its name, since recipes count its changes; a folder is its content;
        other code is its name with the version of its package and the content of its files.

        Raises:
            InputError: the name is unknown, or a file cannot be read.
        """
        from recast.core.artefact import file_hash, folder_hash

        for one in entry_points(f"{self.group}.sources"):
            if name.startswith(f"{one.name}:"):
                return str(self._imported(one.value, name)(name.removeprefix(f"{one.name}:")))
        if name.startswith(tuple(self.prefixes)):
            return name
        if (place := self.place(name)) is not None:
            return file_hash(place) if place.is_file() else folder_hash(place)
        plugins = entry_points(self.group)
        package = plugins[name].dist if name in plugins.names else None
        return code_source(name, self.source_files(name), package.version if package else "")

    def _weights(self, name: str) -> Path | None:
        from recast.weights import place

        return place(self.kind, name)

    def _code(self, value: str | os.PathLike[str]) -> Callable[..., Any]:
        """What makes the part when it is called; readers have their path already."""
        text = os.fspath(value)
        for prefix, code in self.prefixes.items():
            if isinstance(value, str) and text.startswith(prefix):
                return partial(self._imported(code, text), text.removeprefix(prefix))
        path = self.place(value)
        if path is None:
            return self._callable(text) if self.makes_parts else partial(self.load, text)
        return partial(self._imported(self.files.get(path.suffix.lower(), self.folder), text), path)

    def _callable(self, name: str) -> Callable[..., Any]:
        code: Callable[..., Any] = self.load(name)
        if not callable(code):
            raise InputError(self.kind, name, "cannot be called", "name a class or a function")
        return code

    def _imported(self, path: str, name: str) -> Any:
        from recast.core.foreign import place_of, process_kept

        module, _, attribute = path.partition(":")
        if module.partition(".")[0] not in _OWN:
            # What it does to torch is put back only if torch is imported before.
            with suppress(ImportError):
                importlib.import_module("torch")
        search_folder()
        try:
            with process_kept(seed=0):
                imported = importlib.import_module(module)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            reason, hint = f"{error}{place_of(error)}", "correct that module"
            if not module:
                reason, hint = str(error), "give module:attribute"
            elif isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(
                f"{error.name}."
            ):
                top = module.partition(".")[0]
                reason, hint = str(error), f"run in the folder that holds {top}, or install it"
            problem = f"cannot be imported ({type(error).__name__}: {reason})"
            raise InputError(self.kind, name, problem, hint) from error
        if not hasattr(imported, attribute):
            near = nearest(attribute, dir(imported))
            file = getattr(imported, "__file__", None) or module
            hint = f"did you mean {module}:{near}?" if near else "give the name of a class in it"
            problem = f"cannot be imported: {file} does not define {attribute!r}"
            raise InputError(self.kind, name, problem, hint)
        return getattr(imported, attribute)

    def _path(self, name: str) -> str:
        """The "module:attribute" of a name."""
        if self._is_bridged(name) and name not in self.names():
            problem = "is part of recast-bridges, which is not installed"
            raise InputError(self.kind, name, problem, f"run {INSTALLED_BY['recast-bridges']}")
        if ":" in name:
            return name
        plugins = entry_points(self.group)
        if name not in plugins.names:
            raise InputError(self.kind, name, "is not known", self._choices(name))
        return plugins[name].value

    def _is_bridged(self, name: str) -> bool:
        """Whether the name is of a part of recast-bridges; its prefixes are seen to before."""
        bridged = _BRIDGED.get(self.kind, ())
        return name in bridged or name.startswith(tuple(one for one in bridged if one[-1] == ":"))

    def _choices(self, name: str) -> str:
        from recast.weights import PUBLISHED

        published = [name for name, entry in PUBLISHED.items() if entry.part == self.kind]
        if near := nearest(name, [*self.names(), *published]):
            return f"did you mean {near}?"
        if "." in name:
            return f"did you mean {':'.join(name.rsplit('.', 1))}?"
        ways = [
            *(f"the weights {name}" for name in published),
            *(["a folder"] if self.folder else []),
            *(f"a file *{suffix}" for suffix in self.files),
            *(f"{prefix}..." for prefix in self.prefixes),
            "a path module:attribute",
        ]
        names = ", ".join(self.names())
        known = f"choose one of {names}, install its package, or " if names else ""
        return f"{known}give {' or '.join(ways)}"

    def _checked(self, part: Any, name: str, verb: str) -> Any:
        """The part; refused if it is a class in place of an object, or lacks a member."""
        missing = [member for member in self.members if not hasattr(part, member)]
        if not missing and not isinstance(part, type):
            return part
        if isinstance(part, type):
            what = f"{verb} the class {part.__name__}"
        else:
            what = f"{verb} {type(part).__name__}, which lacks {', '.join(missing)}"
        mend = "return" if verb == "made" else "give"
        mend += f" {'an' if self.kind[0] in 'aeiou' else 'a'} {self.kind}"
        if self.protocol:
            mend += f"; see {self.protocol} for what it has"
        raise InputError(self.kind, name, what, mend)


def _called(code: Callable[..., Any], options: Mapping[str, Any]) -> Any:
    known = _parameters(code)
    return code(**{name: value for name, value in options.items() if name in known})


def _parameters(code: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(code).parameters
    except (TypeError, ValueError):  # made in C
        return {}


def code_source(name: str, files: tuple[Path, ...], version: str = "") -> str:
    """What stands for code in keys of artefacts: its name, its version and the hash of its files.

    The version stands for data files, which are not looked at.

    Args:
        files: see `source_files`; for () the name alone is returned.
    """
    from recast.core.artefact import files_hash

    if not files:
        return name
    # Names below the folder that all share: the same code elsewhere is the same code.
    root = Path(os.path.commonpath([file.parent for file in files]))
    return " ".join([name, *([version] if version else []), files_hash(files, root)])


PLANNERS = Registry(
    "planner",
    "recast.planners",
    members=("name", "needs_images", "reset", "plan"),
    protocol="recast.planning.Planner",
)
"""Each is a class or function that makes a `recast.planning.Planner`."""

RESTORERS = Registry(
    "restorer",
    "recast.restorers",
    members=("name", "restore"),
    protocol="recast.simulation.renderer.Restorer",
)
"""Each is a class or function that makes a `recast.simulation.renderer.Restorer`."""

METRICS = Registry(
    "metric",
    "recast.metrics",
    members=("name", "score"),
    protocol="recast.metrics.RolloutMetric",
)
"""Each is a class or function that makes a `recast.metrics.RolloutMetric`."""

GENERATORS = Registry(
    "generator",
    "recast.generators",
    members=("name", "generate"),
    protocol="recast.actors.ActorGenerator",
)
"""Each is a class or function that makes a `recast.actors.ActorGenerator`."""

SEGMENTERS = Registry(
    "segmenter",
    "recast.segmenters",
    members=("segment",),
    protocol="recast.actors.Segmenter",
)
"""Each is a class or function that makes a `recast.actors.Segmenter`."""

DETECTORS = Registry(
    "detector",
    "recast.detectors",
    members=("detect",),
    protocol="recast.metrics.plan_agreement.Detector",
)
"""Each is a class or function that makes a `recast.metrics.plan_agreement.Detector`."""

IMPORTERS = Registry(
    "importer",
    "recast.importers",
    members=("__call__",),
    protocol="recast.logs.importers.LogImporter",
    makes_parts=False,
)
"""Each is a `recast.logs.importers.LogImporter`."""

SCENES = Registry(
    "scene",
    "recast.scenes",
    members=("background", "actors", "at"),
    protocol="recast.scene.StreetScene",
)
"""Each is a class or function that makes a `recast.scene.StreetScene`."""


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
