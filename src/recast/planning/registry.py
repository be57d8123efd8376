"""Planners by name: the built-in ones, installed plugins, and `module:attribute` paths."""

from __future__ import annotations

import importlib
from importlib.metadata import entry_points

from recast.errors import InputError
from recast.planning.types import Planner

ENTRY_POINT_GROUP = "recast.planners"

_BUILT_IN = {
    "constant-velocity": "recast.planning.constant_velocity:ConstantVelocity",
    "idm-follower": "recast.planning.idm_follower:IdmLaneFollower",
    "log-replay": "recast.planning.log_replay:LogReplay",
}


def planner_names() -> tuple[str, ...]:
    """Names that `make_planner` knows, sorted: built in and from installed packages."""
    return tuple(sorted({*_BUILT_IN, *entry_points(group=ENTRY_POINT_GROUP).names}))


def make_planner(name: str) -> Planner:
    """Create a planner.

    Args:
        name: one of `planner_names`, or "package.module:attribute" of a class or function that
            returns a `Planner` when called without arguments.

    Raises:
        InputError: the name is unknown, the module does not import, or what it makes is no planner.
    """
    if ":" in name:
        return _create(name, name)
    if name in _BUILT_IN:
        return _create(name, _BUILT_IN[name])
    plugins = entry_points(group=ENTRY_POINT_GROUP)
    if name not in plugins.names:
        raise InputError(
            "planner",
            name,
            "is not known",
            f"choose one of {', '.join(planner_names())}, or give a path module:attribute",
        )
    return _create(name, plugins[name].value)


def _create(name: str, path: str) -> Planner:
    module, _, attribute = path.partition(":")
    try:
        factory = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(
            "planner", name, f"cannot be imported ({error})", "check the path and the installation"
        ) from error
    if not callable(factory):
        raise InputError("planner", name, "cannot be called", "name a class or a function")
    planner = factory()
    if not isinstance(planner, Planner):
        missing = [m for m in ("name", "needs_images", "reset", "plan") if not hasattr(planner, m)]
        raise InputError(
            "planner",
            name,
            f"made {type(planner).__name__}, which lacks {', '.join(missing)}",
            "see recast.planning.Planner for what a planner has",
        )
    return planner
