"""Code blocks of the documentation, and what they say of the code."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent
from types import ModuleType
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = (REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md")))
_FENCE = re.compile(r"^( *)```([^\n`]*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """One fenced block: its page, the number of its first line, its language and its text."""

    page: Path
    line: int
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(REPOSITORY)}:{self.line}"


def blocks(page: Path) -> Iterator[Block]:
    """All fenced blocks of a page, without the blocks that include a file."""
    text = page.read_text()
    for found in _FENCE.finditer(text):
        if "--8<--" not in found[3]:
            line = text[: found.start(3)].count("\n") + 1
            yield Block(page, line, found[2].strip(), dedent(found[3]))


def commands(block: Block) -> Iterator[tuple[int, list[str]]]:
    """Commands of a shell block that begin with `recast`: line and words.

    A loop's variable stands for its first value, one that is set in the block for its value, and
    any other variable for the letter x.
    """
    if block.language not in ("", "bash", "sh"):
        return
    joined = re.sub(r" *\\\n *", lambda gap: " " + "\0" * gap[0].count("\n"), block.text)
    values = dict(re.findall(r"\bfor (\w+) in (\w+)", joined))
    values |= {name: text for name, _, text in re.findall(r"^(\w+)=([\"'])(.*)\2$", joined, re.M)}
    line = block.line
    for row in joined.splitlines():
        said = re.sub(r"\$\(.*\)|\$\{?(\w+)\}?", lambda var: values.get(var[1], "x"), row)
        said = said.replace("\0", "").strip().split(" && ")[-1]
        if said.startswith("recast "):
            said = re.split(r" #| &$| \| | > ", said)[0]
            yield line, shlex.split(said)[1:]
        line += 1 + row.count("\0")


def faults(block: Block) -> list[str]:
    """What a Python block says of recast that is not so, each with its line."""
    tree = ast.parse(block.text)
    known: dict[str, Any] = {}
    found: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "recast":
                    importlib.import_module(alias.name)
                    known["recast"] = importlib.import_module("recast")
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "recast":
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                value = _named(importlib.import_module(str(node.module)), alias.name)
                if value is None:
                    found.append(f"line {block.line + node.lineno - 1}: no {name}")
                known[alias.asname or alias.name] = value
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and (path := _path(node)) and path[0] == "recast":
            if "recast" in known and _resolve(known, path) is None:
                found.append(f"line {block.line + node.lineno - 1}: no {'.'.join(path)}")
        elif isinstance(node, ast.Call) and (path := _path(node.func)) and path[0] in known:
            callee = _resolve(known, path)
            found += [
                f"line {block.line + node.lineno - 1}: {'.'.join(path)} takes no {keyword}"
                for keyword in _unknown_keywords(callee, node)
            ]
    return found


def _unknown_keywords(callee: Any, call: ast.Call) -> list[str]:
    if not callable(callee) or isinstance(callee, ModuleType):
        return []
    parameters = inspect.signature(callee).parameters
    if any(one.kind is one.VAR_KEYWORD for one in parameters.values()):
        return []
    return [word.arg for word in call.keywords if word.arg and word.arg not in parameters]


def _path(node: ast.expr) -> list[str] | None:
    """Names of a dotted expression; None for any other."""
    if isinstance(node, ast.Name):
        return [node.id]
    if isinstance(node, ast.Attribute) and (before := _path(node.value)):
        return [*before, node.attr]
    return None


def _resolve(known: dict[str, Any], path: list[str]) -> Any:
    value = known.get(path[0])
    for name in path[1:]:
        value = None if value is None else _named(value, name)
    return value


def _named(value: Any, name: str) -> Any:
    """A name of a module or class; a submodule is imported. None if there is no such name."""
    if isinstance(value, ModuleType) and not hasattr(value, name):
        try:
            return importlib.import_module(f"{value.__name__}.{name}")
        except ModuleNotFoundError:
            return None
    return getattr(value, name, None)
