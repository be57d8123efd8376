"""Planners by name: the built-in ones, installed plugins, and `module:attribute` paths."""

from __future__ import annotations

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
            returns a `Planner` when called without arguments.

    Raises:
        InputError: the name is unknown, the module does not import, or what it makes is no planner.
    """
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
