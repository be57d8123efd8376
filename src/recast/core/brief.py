"""How large objects are shown: one line in a console, a small table in a notebook."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from html import escape

from recast.core.errors import printable

REPR_LIMIT = 190
"""Characters of a `repr`, at most: it fits into a line of a log or a debugger."""


class Brief:
    """Base of classes with large members; a dataclass of it needs `repr=False`."""

    @abstractmethod
    def _facts(self) -> Mapping[str, object]:
        """What is shown, by name: plain values, without arrays."""

    def __repr__(self) -> str:
        try:
            facts = ", ".join(f"{name}={value}" for name, value in self._facts().items())
        except Exception:  # debuggers and test reports also show objects that are not valid
            return object.__repr__(self)
        line = printable(f"{type(self).__name__}({facts})")
        return line if len(line) <= REPR_LIMIT else f"{line[: REPR_LIMIT - 2]}…)"

    def _repr_html_(self) -> str:
        """The same as a table, which Jupyter shows."""
        rows = "".join(
            f"<tr><th>{escape(name)}</th><td>{escape(printable(str(value)))}</td></tr>"
            for name, value in self._facts().items()
        )
        return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"
