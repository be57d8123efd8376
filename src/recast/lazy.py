"""Public names of a package, each imported when it is first used: importing it costs nothing."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module


def getattr_of(package: str, places: Mapping[str, Sequence[str]]) -> Callable[[str], object]:
    """The `__getattr__` of a package.

    Args:
        package: its `__name__`.
        places: public names by the module that has them, whole or relative (".store").
    """
    where = {name: module for module, names in places.items() for name in names}

    def found(name: str) -> object:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(where[name], package), name)
        setattr(sys.modules[package], name, value)
        return value

    return found


def names_of(places: Mapping[str, Sequence[str]]) -> list[str]:
    """The `__all__` of a package, see `getattr_of`."""
    return sorted(name for names in places.values() for name in names)
