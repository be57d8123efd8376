"""Every text of the package that a user may read, listed: `python -m support.messages [FOLDER]`."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from support.doc_blocks import REPOSITORY

SOURCE = REPOSITORY / "src" / "recast"


class Message(NamedTuple):
    """One text: where it stands, and its words with `{}` for what is filled in."""

    path: Path
    line: int
    text: str


def messages(folder: Path = SOURCE) -> Iterator[Message]:
    """Texts of two words and more in the code below `folder`.

    Docstrings are left out, but for those of commands and their options, which are the help.
    """
    for path in sorted(folder.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        # Constants that stand alone are docstrings, those of attributes too.
        classes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
        shown = {id(one) for kind in classes for one in kind.body if "cli" in path.parts}
        silent = {
            id(node.value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Expr) and id(node) not in shown
        }
        for node in ast.walk(tree):
            if not isinstance(node, ast.Constant | ast.JoinedStr) or id(node) in silent:
                continue
            if isinstance(node, ast.JoinedStr):
                silent.update(id(part) for part in node.values)
            text = _words(node)
            if " " in text.strip() and any(map(str.isalpha, text)):
                yield Message(path.relative_to(REPOSITORY), node.lineno, text)


def _words(node: ast.AST) -> str:
    if isinstance(node, ast.JoinedStr):
        return "".join(_words(part) or "{}" for part in node.values)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


if __name__ == "__main__":
    for message in messages(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else SOURCE):
        print(f"{message.path}:{message.line}: {message.text!r}")
