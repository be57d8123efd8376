"""Prints lines of Python, files and the median lines of a file: python tools/sizes.py FOLDER ..."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median


def _row(name: str, files: Sequence[Path]) -> str:
    lines = [len(path.read_text(encoding="utf-8").splitlines()) for path in files]
    return f"| {name} | {sum(lines):,} | {len(lines)} | {median(lines):.0f} | {max(lines)} |"


def main(folders: Sequence[str]) -> None:
    """Print one table row for each package, and one for each folder."""
    print("| package | lines | files | median | largest |\n|---|--:|--:|--:|--:|")
    for folder in map(Path, folders):
        for package in sorted(p for p in folder.iterdir() if p.is_dir()):
            if files := sorted(package.rglob("*.py")):
                print(_row(f"{folder.name}/{package.name}", files))
        print(_row(f"**{folder}**", sorted(folder.rglob("*.py"))))


if __name__ == "__main__":
    main(sys.argv[1:])
