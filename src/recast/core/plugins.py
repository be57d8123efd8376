"""Exchangeable parts, found by name, by folder or file, or by the path of their code."""

from __future__ import annotations

import importlib
import inspect
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from recast.core.errors import InputError, nearest
from recast.core.source_files import search_folder, source_files

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints


def entry_points(group: str) -> EntryPoints:
    """The entry points of all installed packages in a group."""
    from importlib.metadata import entry_points as installed

    return installed(group=group)


@dataclass(frozen=True)
class Registry:
    """One kind of exchangeable part, and every way to name one; see `resolve`.

    All code is given as "module:attribute" and imported only when it is needed.

    Attributes:
        group: entry-point group in which other packages announce theirs.
        built_in: name to code.
        members: attributes that tell an object of the kind from other objects.
        protocol: full name of the protocol that documents these members, for messages.
        makes_parts: whether code is a class or function that returns the part when called; if
            False, it is the part.
        folder: code that reads a part from a folder, called with its path; empty if there is none.
        files: suffix of a file's name, in lower case, to the code that reads such a file.
        prefixes: start of a name, such as "library:", to the code that is called with its rest.
        experimental: built-in names of parts that have not met real data.
    """

    kind: str
    group: str
    built_in: Mapping[str, str]
    members: tuple[str, ...] = ()
    protocol: str = ""
    makes_parts: bool = True
    folder: str = ""
    files: Mapping[str, str] = field(default_factory=dict)
    prefixes: Mapping[str, str] = field(default_factory=dict)
    experimental: frozenset[str] = frozenset()

    def names(self) -> tuple[str, ...]:
        """All names, sorted."""
        return tuple(sorted({*self.built_in, *entry_points(group=self.group).names}))

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
        """The files of the code behind a name, see `source_files`; () if it is built in.

        Raises:
            InputError: the name is unknown.
        """
        return source_files(self._path(name))

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
        if not module.startswith("recast."):  # what it does to torch is put back only if it is here
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
        path = self.built_in.get(name, name)
        if ":" in path:
            return path
        plugins = entry_points(group=self.group)
        if name not in plugins.names:
            raise InputError(self.kind, name, "is not known", self._choices(name))
        return plugins[name].value

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


PLANNERS = Registry(
    "planner",
    "recast.planners",
    {
        "constant-velocity": "recast.planning.simple:ConstantVelocity",
        "gtrs-mini": "recast.planning.registry:gtrs_mini_planner",
        "gtrs-mini-oracle": "recast.planning.registry:gtrs_mini_oracle_planner",
        "idm-follower": "recast.planning.idm_follower:IdmLaneFollower",
        "log-replay": "recast.planning.simple:LogReplay",
        "pdm-closed": "recast.planning.pdm:PdmClosedPlanner",
    },
    members=("name", "needs_images", "reset", "plan"),
    protocol="recast.planning.Planner",
    folder="recast.planning.gtrs:load_gtrs",
    prefixes={
        "alpasim:": "recast.protocols.alpasim.driver:driver_planner",
        "navsim:": "recast.planning.registry:navsim_planner",
        "neuroncap:": "recast.protocols.neuroncap.planner:neuroncap_planner",
    },
)
"""Each is a class or function that makes a `recast.planning.Planner`."""

RESTORERS = Registry(
    "restorer",
    "recast.restorers",
    {},
    members=("name", "restore"),
    protocol="recast.simulation.restoring.Restorer",
    prefixes={"harmonizer:": "recast.protocols.harmonizer:harmonizer_restorer"},
)
"""Each is a class or function that makes a `recast.simulation.restoring.Restorer`."""

_VEHICLE_FILE = "recast.actors.vehicle_files:vehicle_generator"

GENERATORS = Registry(
    "generator",
    "recast.generators",
    {
        "auto": "recast.actors.candidates:AutoGenerator",
        "recast-mini": "recast.actors.generate:recast_mini_generator",
        "template": "recast.actors.template:TemplateGenerator",
    },
    members=("name", "generate"),
    protocol="recast.actors.ActorGenerator",
    folder="recast.actors.generate:model_generator",
    files=dict.fromkeys((".ply", ".glb", ".gltf", ".obj", ".spz", ".usda"), _VEHICLE_FILE),
    prefixes={"library:": "recast.actors.library:LibraryGenerator"},
)
"""Each is a class or function that makes a `recast.actors.ActorGenerator`."""

SEGMENTERS = Registry(
    "segmenter",
    "recast.segmenters",
    {"box-lidar": "recast.actors.segment:BoxLidarSegmenter"},
    members=("segment",),
    protocol="recast.actors.Segmenter",
    folder="recast.actors.grounded_segmenter:GroundedSamSegmenter",
)
"""Each is a class or function that makes a `recast.actors.Segmenter`."""

IMPORTERS = Registry(
    "importer",
    "recast.importers",
    {
        "alpasim": "recast.protocols.alpasim.bundle_read:load_alpasim",
        "argoverse2": "recast.logs.importers.argoverse2:load_argoverse2",
        "drivestudio": "recast.logs.importers.drivestudio:load_drivestudio",
        "kitti": "recast.logs.importers.kitti:load_kitti",
        "nuscenes": "recast.logs.importers.nuscenes:load_nuscenes",
        "py123d": "recast.logs.importers.py123d:load_py123d",
        "street-gaussians": "recast.logs.importers.street_gaussians:load_street_gaussians",
        "waymo": "recast.logs.importers.waymo:load_waymo",
        "waymo-v2": "recast.logs.importers.waymo:load_waymo2",
    },
    members=("__call__",),
    protocol="recast.logs.importers.LogImporter",
    makes_parts=False,
    experimental=frozenset(
        {"alpasim", "drivestudio", "nuscenes", "py123d", "street-gaussians", "waymo-v2"}
    ),
)
"""Each is a `recast.logs.importers.LogImporter`."""

SCENES = Registry(
    "scene",
    "recast.scenes",
    {},
    members=("background", "actors", "at"),
    protocol="recast.scene.StreetScene",
    folder="recast.scene.store:load_scene",
)
"""Each is a class or function that makes a `recast.scene.StreetScene`."""
