"""Content hashes: what a step was made from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

_CHUNK = 1 << 20


def file_hash(path: str | Path) -> str:
    """BLAKE2b-128 of a file's bytes, as hex."""
    digest = hashlib.blake2b(digest_size=16)
    with Path(path).open("rb") as stream:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def folder_hash(folder: str | Path) -> str:
    """BLAKE2b-128 over the relative names and bytes of all files below a folder, in name order."""
    folder = Path(folder)
    return files_hash(sorted(p for p in folder.rglob("*") if p.is_file()), folder)


def files_hash(files: Iterable[Path], root: Path) -> str:
    """BLAKE2b-128 over the names below `root` and the bytes of files, in the order given."""
    digest = hashlib.blake2b(digest_size=16)
    for path in files:
        name = path.relative_to(root).as_posix()
        digest.update(name.encode("utf-8", "surrogateescape") + b"\0")
        digest.update(bytes.fromhex(file_hash(path)))
    return digest.hexdigest()


def value_hash(value: Any) -> str:
    """BLAKE2b-128 of a JSON-able value, independent of key order."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
