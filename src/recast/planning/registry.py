"""Planners by name: built in, installed, `module:attribute`, NAVSIM agents, folders."""

from __future__ import annotations

from pathlib import Path

from recast.parts import PLANNERS
from recast.planning.device import planner_device
from recast.planning.shipped import GTRS_MINI, gtrs_mini
from recast.planning.types import Planner

NAVSIM_PREFIX = "navsim:"
"""Before the "module:attribute" of a NAVSIM agent."""


def make_planner(planner: str | Path | Planner, device: str = "auto") -> Planner:
    """Create a planner, or return the one given.

    Args:
        planner: one of `PLANNERS.names()`; or "package.module:attribute" of a class or function
            that returns a `Planner` when called without arguments; or
            "navsim:package.module:attribute" of one that returns a NAVSIM agent; or a folder that
            `save_gtrs` wrote; or a `Planner`. See `recast.plugins.Registry.resolve`.
        device: where it computes, see `planner_device`. A class or function of the user's is given
            it if it has a parameter `device`; what has none decides itself.

    Raises:
        InputError: there is no such device; the name is unknown, the module does not import, what
            it names raises when it is called (its exception is the error's `__cause__`) or makes no
            planner; or a file of the folder is missing or wrong.
    """
    options = {}
    if PLANNERS.takes(planner, "device"):
        options["device"] = planner_device(device)
    made: Planner = PLANNERS.resolve(planner, **options)
    return made


def navsim_planner(agent: str, device: str = "cpu") -> Planner:
    """The planner of a NAVSIM agent.

    Args:
        agent: "package.module:attribute" of a class or function that returns it.
        device: given to that if it has a parameter of this name.

    Raises:
        InputError: the agent cannot be imported, or it is no agent that can be simulated. Other
            exceptions of its code pass.
    """
    from recast.planning.navsim import NavsimPlanner

    return NavsimPlanner(PLANNERS.make(agent, device=device))


def planner_folder(name: str) -> Path | None:
    """The folder that holds all of a planner, or None where code makes it.

    It need not be there.
    """
    return gtrs_mini() if name == GTRS_MINI else PLANNERS.place(name)


def planner_source_files(name: str) -> tuple[Path, ...]:
    """The files of a user's own code behind a planner's name, see `recast.plugins.source_files`.

    () for built-in planners and for folders.

    Raises:
        InputError: the name is unknown.
    """
    if planner_folder(name) is not None:
        return ()
    return PLANNERS.source_files(name.removeprefix(NAVSIM_PREFIX))
