"""Planners by name: built-in ones, installed plugins, `module:attribute` paths, GTRS folders."""

from __future__ import annotations

from pathlib import Path

from recast.errors import InputError
from recast.planning.types import Planner
from recast.plugins import Registry

PLANNERS = Registry(
    "planner",
    "recast.planners",
    {
        "constant-velocity": "recast.planning.constant_velocity:ConstantVelocity",
        "idm-follower": "recast.planning.idm_follower:IdmLaneFollower",
        "log-replay": "recast.planning.log_replay:LogReplay",
        "pdm-closed": "recast.planning.pdm:PdmClosedPlanner",
    },
)
"""Planners by name; each is a class or function that makes a `Planner`."""


def make_planner(name: str) -> Planner:
    """Create a planner.

    Args:
        name: one of `PLANNERS.names()`, or "package.module:attribute" of a class or function that
            returns a `Planner` when called without arguments, or a folder that `save_gtrs` wrote.

    Raises:
        InputError: the name is unknown, the module does not import, what it makes is no planner, or
            a file of the folder is missing or wrong.
    """
    # A name wins over a folder that happens to be called alike.
    if name not in PLANNERS.names() and ("/" in name or Path(name).is_dir()):
        from recast.planning.gtrs import load_gtrs  # here, as it needs torch and others do not

        return load_gtrs(name)
    factory = PLANNERS.load(name)
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
