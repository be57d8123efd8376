"""One name, one meaning: a public class has its name alone in the whole tree."""

from __future__ import annotations

import ast
from collections import defaultdict

from support.doc_blocks import REPOSITORY

THEIRS = {"Trajectory"}
"""Class of NAVSIM, which agents import by this name from `recast_bridges.navsim`."""


def test_public_classes_have_names_of_their_own() -> None:
    places = defaultdict(list)
    for root in ("src", "bridges/src", "tools/src"):
        for path in sorted((REPOSITORY / root).rglob("*.py")):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    places[node.name].append(str(path.relative_to(REPOSITORY)))
    several = {name: paths for name, paths in places.items() if len(paths) > 1}
    assert len(places) > 900
    assert several.keys() <= THEIRS, several
