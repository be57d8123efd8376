"""Reads a table over and over, each time with one byte of its metadata changed.

Run as a program, `python every_byte.py FILE FIRST`: a reader that ends the process ends this one.
Prints how many of the changed files were read and how many were refused in one line.
"""

from __future__ import annotations

import sys
from pathlib import Path

from recast.core.errors import InputError
from recast.core.table_files import read_feather, read_parquet


def main(path: Path, first: int) -> None:
    """Change each byte from `first` on to two other values."""
    whole = path.read_bytes()
    read = read_feather if path.suffix == ".feather" else read_parquet
    columns = ["number", "text", "half"]
    accepted = refused = 0
    for at in range(first, len(whole)):
        for value in (255, whole[at] ^ 16):
            path.write_bytes(whole[:at] + bytes([value]) + whole[at + 1 :])
            try:
                table = read(path, columns, "mend it")
                table.data.to_pylist()
                accepted += 1
            except InputError:
                refused += 1
    print(accepted, refused)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
