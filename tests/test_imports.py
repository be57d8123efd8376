"""What tests share lies in `tests/support`: a test module can be moved or removed by itself."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

TESTS = Path(__file__).parent


def imported(path: Path, root: Path) -> Iterator[Path]:
    """Modules below `root` that a module imports, at its top or anywhere else."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            module = f"{node.module}." if node.module else ""
            names = [f"{module}{name.name}" for name in node.names]
        else:
            continue
        level = node.level if isinstance(node, ast.ImportFrom) else 0
        # pytest puts the lowest folder without an __init__.py on the path.
        above = [folder for folder in path.parents if folder.is_relative_to(root)]
        places = [path.parents[level - 1]] if level else above
        for name in names:
            # The last part is a module, or a name in one.
            parts = name.replace(".", "/"), name.rpartition(".")[0].replace(".", "/")
            files = [place / f"{part}.py" for place in places for part in parts if part]
            yield from [file for file in files if file.is_file()][:1]


def faults(root: Path) -> list[str]:
    """Imports that tie one test to another: `importer imports imported`."""
    lines = []
    for path in sorted(root.rglob("*.py")):
        own = path.relative_to(root).parts[0]
        for found in imported(path, root):
            folder = found.relative_to(root).parts[0]
            test = found.name.startswith("test_") or found.name == "conftest.py"
            if test or folder not in ("support", own):
                lines.append(f"{path.relative_to(root)} imports {found.relative_to(root)}")
    return lines


def test_no_test_imports_from_another_test_or_from_the_helpers_of_another_folder() -> None:
    assert faults(TESTS) == []


def test_every_way_to_write_such_an_import_is_found(tmp_path: Path) -> None:
    for name in ("support/street.py", "one/helper.py", "one/test_a.py", "one/deep/conftest.py"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    ways = (
        "from one.helper import x",
        "import one.helper as h",
        "from one import helper",
        "def f():\n    from one.deep.conftest import x",
    )
    (tmp_path / "two").mkdir()
    for number, way in enumerate(ways):
        (tmp_path / f"two/test_{number}.py").write_text(way)
    (tmp_path / "one/test_b.py").write_text("from test_a import x\nfrom .helper import y")
    (tmp_path / "one/deep/test_c.py").write_text("from .conftest import x\nfrom ..helper import y")
    (tmp_path / "two/test_good.py").write_text("from support import street\nimport one_more.helper")
    assert faults(tmp_path) == [
        "one/deep/test_c.py imports one/deep/conftest.py",
        "one/test_b.py imports one/test_a.py",
        "two/test_0.py imports one/helper.py",
        "two/test_1.py imports one/helper.py",
        "two/test_2.py imports one/helper.py",
        "two/test_3.py imports one/deep/conftest.py",
    ]
