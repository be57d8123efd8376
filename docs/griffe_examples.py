"""Griffe extension: shows the doctests at the end of a docstring as its section "Examples"."""

from __future__ import annotations

import re
from typing import Any

import griffe


class DoctestExamples(griffe.Extension):
    """Puts the heading `Examples:` before the first line that begins with `>>>`."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of one object."""
        if obj.docstring is None or "Examples:\n" in obj.docstring.value:
            return
        text, *found = re.split(r"^(?=>>> )", obj.docstring.value, maxsplit=1, flags=re.M)
        if found:
            example = "".join(f"    {line}\n" for line in found[0].splitlines())
            obj.docstring.value = f"{text}Examples:\n{example}"
