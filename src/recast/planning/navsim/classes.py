"""Which classes an agent is given: those of the installed `navsim` package, or ours."""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from typing import Any

from recast.errors import InputError
from recast.planning.navsim import types

_MODULE = "navsim.common.dataclasses"


@dataclass(frozen=True)
class NavsimClasses:
    """Classes with NAVSIM's field names."""

    agent_input: Any
    camera: Any
    cameras: Any
    ego_status: Any
    lidar: Any

    @classmethod
    def of(cls, module: Any) -> NavsimClasses:
        """Those of a module that calls them as NAVSIM does."""
        return cls(module.AgentInput, module.Camera, module.Cameras, module.EgoStatus, module.Lidar)


def navsim_classes(installed: bool | None) -> NavsimClasses:
    """The classes to use.

    Args:
        installed: True for those of the `navsim` package, False for ours. None for the package's
            where it is loaded already, as it is when the agent's module imports it.

    Raises:
        InputError: the package's are asked for, and it cannot be imported.
    """
    if installed is None:
        installed = _MODULE in sys.modules
    if not installed:
        return NavsimClasses.of(types)
    try:
        return NavsimClasses.of(importlib.import_module(_MODULE))
    except ImportError as error:
        raise InputError(
            "navsim", "package", f"cannot be imported ({error})",
            "install it, or leave installed_classes out: agents need not import it",
        ) from None  # fmt: skip
