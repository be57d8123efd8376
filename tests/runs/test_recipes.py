"""Recipe versions: code of a step that changes without its version fails here.

`make recipes` writes recipes.json anew. Before you run it, decide whether the step writes something
else for the same inputs now; if it does, raise its number in `recast.runs.sources.RECIPES` first.
"""

from __future__ import annotations

import ast
import hashlib
import json
from functools import cache
from pathlib import Path

import pytest

from recast.runs.sources import RECIPES

SOURCE = Path(__file__).parents[2] / "src" / "recast"
ACCEPTED = Path(__file__).with_name("recipes.json")
CODE = {
    "log": ("logs", "synthetic", "core/table_files.py"),
    "actor": ("actors", "reconstruction", "scene", "splats", "trellis", "runs/actor.py"),
    "refine": ("actors", "reconstruction", "scene", "splats"),
    "turntable": ("actors", "splats"),
    "scene": ("reconstruction", "scene", "splats"),
    "evaluation": ("reconstruction", "scene", "splats", "metrics/perceptual.py"),
    "truth": ("metrics", "synthetic"),
    "rollout": (
        *("simulation", "planning", "dynamics", "scene", "splats", "synthetic"),
        "runs/rollouts.py",
    ),
    "plans": (
        *("simulation", "planning", "dynamics", "scene", "splats"),
        "metrics/plan_agreement.py",
    ),
    "scene-level": (
        *("metrics/scene_level_images.py", "metrics/scene_level_table.py"),
        *("studies/scene_level_study.py", "studies/scene_level_tasks.py", "pretrained"),
    ),
    "metrics": ("metrics", "runs/scores.py"),
    "report": ("reporting", "runs/report.py"),
}
"""Packages and modules whose code decides what a step writes. `core`, `geometry` and `cameras`,
which all steps share, are left out: what they compute has tests with fixed numbers."""


class _Result(ast.NodeTransformer):
    """Leaves what cannot change a result out: docstrings, imports, the words of errors."""

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        return None if isinstance(node.value, ast.Constant) else self.generic_visit(node)

    def visit_Import(self, node: ast.Import) -> None:
        return None

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        return None

    def visit_Raise(self, node: ast.Raise) -> ast.Raise:
        return ast.Raise(exc=None, cause=None)


def tree_hash(text: str) -> str:
    """Hash of a module's syntax tree, see `_Result`."""
    return hashlib.sha256(repr(_plain(_Result().visit(ast.parse(text)))).encode()).hexdigest()


def _plain(value: object) -> object:
    """A tree as nested tuples, the same in each version of Python, whose nodes gain fields."""
    if isinstance(value, list):
        return tuple(map(_plain, value))
    if not isinstance(value, ast.AST):
        return value
    parts: list[object] = [type(value).__name__]
    for name, inner in ast.iter_fields(value):
        if inner is not None and (inner or inner != []):
            parts.append((name, _plain(inner)))
    return tuple(parts)


@cache
def module_hash(path: Path) -> str:
    """`tree_hash` of a file; several steps share it."""
    return tree_hash(path.read_text())


def code_hash(step: str) -> str:
    """Hash of all modules of a step, whatever they are called."""
    places = [SOURCE / part for part in CODE[step]]
    paths = [p for one in places for p in (one.rglob("*.py") if one.is_dir() else [one])]
    assert all(path.is_file() for path in paths) and paths
    found = sorted(module_hash(path) for path in paths)
    return hashlib.sha256("".join(found).encode()).hexdigest()[:16]


@cache
def accepted() -> dict[str, dict[str, str | int]]:
    """Version and hash of each step as this tree has them."""
    return {step: {"version": RECIPES[step], "code": code_hash(step)} for step in RECIPES}


@pytest.mark.parametrize("step", RECIPES)
def test_code_that_changes_has_another_version(step: str) -> None:
    known = json.loads(ACCEPTED.read_text())[step]
    assert known == accepted()[step], (
        f"the code of the step {step} has changed: if it writes something else for the same "
        f"inputs, raise RECIPES[{step!r}]; then run `make recipes`"
    )


def test_every_step_has_its_code() -> None:
    assert CODE.keys() == RECIPES.keys()


CHANGES = {
    '"""Other words."""\nimport b\ndef f(x):\n    """More."""\n    raise ValueError("y")\n': True,
    "def f(x):\n    raise ValueError\n": True,
    "def f(x):\n    return 2\n": False,
    "LIMIT = 2\ndef f(x):\n    raise ValueError\n": False,
}


@pytest.mark.parametrize("text", CHANGES)
def test_words_are_not_code(text: str) -> None:
    before = '"""Words."""\nimport a\ndef f(x):\n    """Words."""\n    raise ValueError("x")\n'
    assert (tree_hash(text) == tree_hash(before)) is CHANGES[text]


if __name__ == "__main__":
    ACCEPTED.write_text(json.dumps(accepted(), indent=2) + "\n")
