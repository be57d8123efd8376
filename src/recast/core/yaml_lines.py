"""The reader of all foreign YAML: data that knows its lines, so that an error can point at one.

Nothing is constructed: only the tree of a document is read, and its scalars are text, numbers,
truth values or nothing. Tags, which could ask for more, are refused. The tree has at most
`MOST_NODES` nodes and `MOST_LEVELS` levels, every alias counted as the nodes that it stands for: a
few hundred bytes of aliases of aliases can stand for more than any memory holds.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from recast.core import files
from recast.core.errors import InputError

MOST_NODES = 10_000
MOST_LEVELS = 20

_MEND = "write it like the examples in the documentation"
_PLAIN_TAGS = ("str", "int", "float", "bool", "null", "map", "seq", "timestamp", "merge", "value")
_NUMBER = re.compile(r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?")
"""As people write numbers; Python's would be 1_0, nan and infinity, too."""
_TRUTH = {"true": True, "false": False}


@dataclass(frozen=True)
class YamlNode:
    """A value and where it stands.

    Attributes:
        value: text, float, bool or None; a dict of nodes by key; a list of nodes.
        place: `file:line`, as compilers write it; the line is from 1, that of its key where it has
            one. The source's name alone for data that came from no file.
    """

    value: Any
    place: str

    def error(self, field: str, problem: str | None, mend: str) -> InputError:
        """An error at this place; the problem is what the value is where none is given."""
        return InputError(self.place, field, problem or f"is {self.shown}", mend)

    @property
    def plain(self) -> Any:
        """The value with plain values below it, as `json.loads` would give it."""
        if isinstance(self.value, dict):
            return {key: node.plain for key, node in self.value.items()}
        return [node.plain for node in self.value] if isinstance(self.value, list) else self.value

    @property
    def shown(self) -> str:
        """The value as an error shows it."""
        value = self.value
        if value is None:
            return "empty"
        if isinstance(value, dict | list):
            return "a list of keys" if isinstance(value, dict) else "a list"
        if isinstance(value, bool):
            return str(value).lower()
        if isinstance(value, float):
            return f"the number {value:g}"
        text = repr(str(value))
        return text if len(text) <= 40 else f"{text[:36]}...'"


def nodes_of(value: Any, where: str, levels: int = MOST_LEVELS) -> YamlNode:
    """Nodes of plain data, as JSON has it, of at most some levels.

    Args:
        where: name of its source, for errors.

    Raises:
        InputError: it has more levels.
    """
    if isinstance(value, Mapping | list | tuple) and levels == 0:
        raise InputError(where, "value", "is nested too deeply", _MEND)
    if isinstance(value, Mapping):
        members = {str(key): nodes_of(one, where, levels - 1) for key, one in value.items()}
        return YamlNode(members, where)
    if isinstance(value, list | tuple):
        return YamlNode([nodes_of(one, where, levels - 1) for one in value], where)
    return YamlNode(_number(value) if type(value) is int else value, where)


def read_yaml_file(path: str | Path, most_bytes: int) -> YamlNode:
    """The tree of a file of one YAML document, with or without a byte order mark.

    Raises:
        InputError: see `read_yaml`; or the file cannot be read, is too long or is not UTF-8.
    """
    return read_yaml(files.read_bytes(path, most_bytes), str(path))


def read_yaml(text: str | bytes, where: str) -> YamlNode:
    """The tree of one YAML document.

    Args:
        text: document; bytes are UTF-8, with or without a byte order mark.
        where: name of its file, for errors.

    Raises:
        InputError: not UTF-8, not YAML, more than one document, a key given twice, a tag, too many
            nodes or levels.
    """
    if isinstance(text, bytes):
        try:
            text = text.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = error.object.count(b"\n", 0, error.start) + 1
            raise InputError(f"{where}:{line}", "file", "is not UTF-8 text", _MEND) from None
    try:
        loader = _Loader(text)
        loader.where = where
        root = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        at = where if mark is None else f"{where}:{mark.line + 1}"
        problem = f"cannot be read ({error.problem or error.context})"
        raise InputError(at, "YAML", problem, _MEND) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        problem = f"holds a character that YAML does not allow ({error.reason})"
        raise InputError(f"{where}:{line}", "YAML", problem, "remove it") from None
    if root is None:
        raise InputError(where, "YAML", "is empty", _MEND)
    return _Tree(where).node(root, root.start_mark.line + 1, ())


class _Loader(yaml.SafeLoader):
    """Composes nodes while there are few enough of them."""

    where = ""
    nodes = 0
    level = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """One node with all below it; called by itself for these."""
        self.nodes += 1
        self.level += 1
        line = self.peek_event().start_mark.line + 1
        _refuse_if_large(self.nodes, self.level, f"{self.where}:{line}")
        node: yaml.Node | None = super().compose_node(parent, index)
        self.level -= 1
        return node


def _refuse_if_large(nodes: int, levels: int, where: str) -> None:
    if levels > MOST_LEVELS:
        raise InputError(where, "YAML", "is nested too deeply", _MEND)
    if nodes > MOST_NODES:
        raise InputError(where, "YAML", f"has more than {MOST_NODES} values", _MEND)


class _Tree:
    """From composed nodes to ours; where an alias stands, there its nodes stand again."""

    def __init__(self, where: str) -> None:
        self._where, self._nodes = where, 0

    def node(self, node: yaml.Node, line: int, above: tuple[yaml.Node, ...]) -> YamlNode:
        """One node; `above` are those that it lies in."""
        where = f"{self._where}:{line}"
        if any(node is outer for outer in above):
            raise InputError(
                where, "YAML", "holds an alias that refers to itself", "write the value out"
            )
        self._nodes += 1
        inner = (*above, node)
        _refuse_if_large(self._nodes, len(inner), where)
        tag = str(node.tag).removeprefix("tag:yaml.org,2002:")
        if tag not in _PLAIN_TAGS:
            raise InputError(where, "YAML", f"has the tag {node.tag}", "remove the tag")
        if isinstance(node, yaml.MappingNode):
            return YamlNode(self._members(node, inner), where)
        if isinstance(node, yaml.SequenceNode):
            return YamlNode([self.node(o, o.start_mark.line + 1, inner) for o in node.value], where)
        return YamlNode(node.value if node.style else _plain(node.value), where)

    def _members(self, node: yaml.MappingNode, above: tuple[yaml.Node, ...]) -> dict[str, YamlNode]:
        members: dict[str, YamlNode] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            where = f"{self._where}:{line}"
            if not isinstance(key_node, yaml.ScalarNode):
                raise InputError(where, "YAML", "has a key that is not a word", _MEND)
            key = key_node.value
            if key in members:
                first = members[key].place.rpartition(":")[2]
                problem = f"is given twice, first in line {first}"
                raise InputError(where, key, problem, "remove one of them")
            members[key] = self.node(value_node, line, above)
        return members


def _plain(text: str) -> str | float | bool | None:
    """What a scalar without quotes means. YAML 1.1 would take 1:30 for 90 and `on` for true."""
    if text.lower() in ("", "~", "null"):
        return None
    if text.lower() in _TRUTH:
        return _TRUTH[text.lower()]
    return float(text) if _NUMBER.fullmatch(text) else text


def _number(value: int) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
