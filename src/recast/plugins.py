"""Parts found by name: the built-in ones, and those of installed packages (entry points)."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

from recast.errors import InputError


@dataclass(frozen=True)
class Registry:
    """One kind of exchangeable part.

    Attributes:
        kind: for messages, such as "planner".
        group: entry-point group in which other packages announce theirs.
        built_in: name to "module:attribute". Imported only when asked for.
    """

    kind: str
    group: str
    built_in: Mapping[str, str]

    def names(self) -> tuple[str, ...]:
        """All names, sorted."""
        return tuple(sorted({*self.built_in, *entry_points(group=self.group).names}))

    def load(self, name: str) -> Any:
        """The object of that name; "module:attribute" names any importable object.

        Raises:
            InputError: the name is unknown, or what it stands for cannot be imported.
        """
        path = self.built_in.get(name, name)
        if ":" not in path:
            plugins = entry_points(group=self.group)
            if name not in plugins.names:
                raise InputError(
                    self.kind, name, "is not known",
                    f"choose one of {', '.join(self.names())}, install its package, "
                    "or give a path module:attribute",
                )  # fmt: skip
            path = plugins[name].value
        module, _, attribute = path.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError, ValueError) as error:
            raise InputError(
                self.kind, name, f"cannot be imported ({error})",
                "check the path and the installation",
            ) from error  # fmt: skip
