"""YAML as data that knows its lines, so that an error can point at one.

Nothing is constructed: only the tree of a document is read, and its scalars are text, numbers,
truth values or nothing. Tags, which could ask for more, are refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from recast.errors import InputError

_MEND = "write it as the examples in docs/scenarios.md"
_PLAIN_TAGS = ("str", "int", "float", "bool", "null", "map", "seq", "timestamp", "merge", "value")
_TRUTH = {"true": True, "false": False}


@dataclass(frozen=True)
class Node:
    """A value and where it stands.

    Attributes:
        value: text, float, bool or None; a dict of nodes by key; a list of nodes.
        line: from 1; of its key where it has one. None for data that came from no file.
    """

    value: Any
    line: int | None = None


def place(where: str, line: int | None) -> str:
    """`where:line`, as compilers write it."""
    return where if line is None else f"{where}:{line}"


def located(value: Any) -> Node:
    """Nodes without lines from plain data."""
    if isinstance(value, Mapping):
        return Node({str(key): located(one) for key, one in value.items()})
    if isinstance(value, list | tuple):
        return Node([located(one) for one in value])
    if isinstance(value, int) and not isinstance(value, bool):
        return Node(float(value))
    return Node(value)


def read_yaml(text: str, where: str) -> Node:
    """The tree of one YAML document.

    Args:
        where: its file, for errors.

    Raises:
        InputError: not YAML, more than one document, a key given twice, or a tag.
    """
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = None if mark is None else mark.line + 1
        problem = f"cannot be read ({error.problem or error.context})"
        raise InputError(place(where, line), "YAML", problem, _MEND) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        problem = f"holds a character that YAML does not allow ({error.reason})"
        raise InputError(place(where, line), "YAML", problem, "remove it") from None
    except RecursionError:
        raise InputError(where, "YAML", "is nested too deeply", _MEND) from None
    if root is None:
        raise InputError(where, "YAML", "is empty", _MEND)
    return _node(root, root.start_mark.line + 1, where, ())


def _node(node: yaml.Node, line: int, where: str, above: tuple[yaml.Node, ...]) -> Node:
    tag = str(node.tag).removeprefix("tag:yaml.org,2002:")
    if tag not in _PLAIN_TAGS:
        raise InputError(place(where, line), "YAML", f"has the tag {node.tag}", "remove the tag")
    if any(node is outer for outer in above):
        raise InputError(place(where, line), "YAML", "holds an alias of itself", "write it out")
    inner = (*above, node)
    if isinstance(node, yaml.MappingNode):
        return Node(_mapping(node, where, inner), line)
    if isinstance(node, yaml.SequenceNode):
        items = [_node(one, one.start_mark.line + 1, where, inner) for one in node.value]
        return Node(items, line)
    return Node(node.value if node.style else _plain(node.value), line)


def _mapping(node: yaml.MappingNode, where: str, above: tuple[yaml.Node, ...]) -> dict[str, Node]:
    members: dict[str, Node] = {}
    for key_node, value_node in node.value:
        line = key_node.start_mark.line + 1
        if not isinstance(key_node, yaml.ScalarNode):
            raise InputError(place(where, line), "YAML", "has a key that is no word", _MEND)
        key = key_node.value
        if key in members:
            problem = f"is given twice, first in line {members[key].line}"
            raise InputError(place(where, line), key, problem, "remove one of them")
        members[key] = _node(value_node, line, where, above)
    return members


def _plain(text: str) -> str | float | bool | None:
    """What a scalar without quotes means. YAML 1.1 would take 1:30 for 90 and `on` for true."""
    if text.lower() in ("", "~", "null"):
        return None
    if text.lower() in _TRUTH:
        return _TRUTH[text.lower()]
    try:
        return float(text)
    except ValueError:
        return text
