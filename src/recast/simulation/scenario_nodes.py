"""Members of a scenario file's tree, checked: each error names file, line and key."""

from __future__ import annotations

import re
from difflib import get_close_matches
from typing import Any

from recast.errors import InputError
from recast.simulation.yaml_lines import Node, place

_WORD = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_LONGEST_WORD = 40  # names become folder names


def required(node: Node, key: str, where: str, mend: str) -> Node:
    """The member `key` of a mapping; `mend` says what to write if it is missing."""
    if key not in node.value:
        raise InputError(place(where, node.line), key, "is missing", mend)
    found: Node = node.value[key]
    return found


def known_only(node: Node, known: tuple[str, ...], where: str) -> None:
    """Refuse members of a mapping with other keys than `known`."""
    for key, member in node.value.items():
        if key not in known:
            near = get_close_matches(key, known, 1)
            mend = f"did you mean {near[0]}?" if near else f"the keys are {', '.join(known)}"
            raise InputError(place(where, member.line), key, "is not known", mend)


def word(text: Any, node: Node, field: str, where: str) -> str:
    """A name of small letters, digits and hyphens; `node` is where it stands."""
    if not isinstance(text, str) or len(text) > _LONGEST_WORD or not _WORD.fullmatch(text):
        problem = f"is {shown(Node(text))}"
        mend = "use small letters, digits and single hyphens, 40 at most, in quotes if all digits"
        raise InputError(place(where, node.line), field, problem, mend)
    return text


def shown(node: Node) -> str:
    """A value as an error shows it."""
    value = node.value
    if value is None:
        return "empty"
    if isinstance(value, dict):
        return "a list of keys"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, float):
        return f"the number {value:g}"
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(str(value))
    return text if len(text) <= 40 else f"{text[:36]}...'"
