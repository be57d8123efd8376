"""Planners by name: built in, installed plugins, `module:attribute`, NAVSIM agents, folders."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import Parameter, signature
from pathlib import Path
from typing import Any

from recast.errors import InputError
from recast.parts import PLANNERS
from recast.planning.device import planner_device
from recast.planning.shipped import GTRS_MINI, gtrs_mini
from recast.planning.types import Planner

NAVSIM_PREFIX = "navsim:"
"""Before the "module:attribute" of a NAVSIM agent."""


def make_planner(name: str, device: str = "auto") -> Planner:
    """Create a planner.

    Args:
        name: one of `PLANNERS.names()`; or "package.module:attribute" of a class or function that
            returns a `Planner` when called without arguments; or "navsim:package.module:attribute"
            of one that returns a NAVSIM agent; or a folder that `save_gtrs` wrote.
        device: where it computes, see `planner_device`. A class or function of the user's is given
            it if it has a parameter `device`; what has none decides itself.

    Raises:
        InputError: there is no such device; the name is unknown, the module does not import, what
            it names raises when it is called (its exception is the error's `__cause__`) or makes no
            planner; or a file of the folder is missing or wrong.
    """
    try:
        planner = _made(name, device)
    except InputError:
        raise
    except (Exception, SystemExit) as error:  # code of the user
        raise InputError(
            "planner", name, f"cannot be made ({type(error).__name__}: {error})",
            "name a class or function that works when called without arguments",
        ) from error  # fmt: skip
    if isinstance(planner, type) or not isinstance(planner, Planner):
        members = ("name", "needs_images", "reset", "plan")
        missing = ", ".join(member for member in members if not hasattr(planner, member))
        what = f"made {type(planner).__name__}" + (f", which lacks {missing}" if missing else "")
        if isinstance(planner, type):
            what = f"made the class {planner.__name__}"
        raise InputError(
            "planner", name, what, "return a planner; see recast.planning.Planner for what it has"
        )
    return planner


def planner_folder(name: str) -> Path | None:
    """The folder that holds all of a planner, or None where code makes it.

    It need not be there.
    """
    if name == GTRS_MINI:
        return gtrs_mini()
    # A name wins over a folder that happens to be called alike.
    if name not in PLANNERS.names() and ("/" in name or Path(name).is_dir()):
        return Path(name)
    return None


def planner_source_files(name: str) -> tuple[Path, ...]:
    """The files of a user's own code behind a planner's name, see `recast.plugins.source_files`.

    () for built-in planners and for folders.

    Raises:
        InputError: the name is unknown.
    """
    if planner_folder(name) is not None:
        return ()
    return PLANNERS.source_files(name.removeprefix(NAVSIM_PREFIX))


def _made(name: str, device: str) -> Any:
    if name not in PLANNERS.names() and (folder := planner_folder(name)) is not None:
        from recast.planning.gtrs import load_gtrs  # here, as it needs torch and others do not

        return load_gtrs(folder, planner_device(device))
    if not name.startswith(NAVSIM_PREFIX):
        return _called(name, name, device)
    from recast.planning.navsim import NavsimPlanner

    return NavsimPlanner(_called(name, name.removeprefix(NAVSIM_PREFIX), device))


def _called(name: str, path: str, device: str) -> Any:
    factory = PLANNERS.load(path)
    if not callable(factory):
        raise InputError("planner", name, "cannot be called", "name a class or a function")
    try:
        parameters: Mapping[str, Parameter] = signature(factory).parameters
    except (TypeError, ValueError):  # made in C
        parameters = {}
    return factory(device=planner_device(device)) if "device" in parameters else factory()
