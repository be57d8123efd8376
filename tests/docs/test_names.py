"""One name, one meaning: of classes in the whole tree, and of all names in a module."""

from __future__ import annotations

import ast
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

from support.doc_blocks import REPOSITORY

THEIRS = {"Trajectory"}
"""Class of NAVSIM, which agents import by this name from `recast_bridges.navsim`."""


def sources() -> list[Path]:
    return [
        path
        for root in ("src", "bridges/src", "tools/src")
        for path in sorted((REPOSITORY / root).rglob("*.py"))
    ]


def bound(body: list[ast.stmt]) -> Iterator[str]:
    """Names that the statements of a module bind; overloads and branches are not followed."""
    for node in body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            if not any("overload" in ast.unparse(one) for one in node.decorator_list):
                yield node.name
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            yield from (one.asname or one.name for one in node.names)
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                yield from (
                    one.id
                    for one in ast.walk(target)
                    if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)
                )


def test_a_module_binds_a_name_once() -> None:
    """Two files that become one may have constants of one name: the second would win in silence."""
    for path in sources():
        counted = Counter(bound(ast.parse(path.read_text(encoding="utf-8")).body))
        twice = [name for name, count in counted.items() if count > 1]
        assert not twice, f"{path}: {twice}"


def test_public_classes_have_names_of_their_own() -> None:
    places = defaultdict(list)
    for path in sources():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path.relative_to(REPOSITORY)))
    several = {name: paths for name, paths in places.items() if len(paths) > 1}
    assert len(places) > 900
    assert several.keys() <= THEIRS, several
