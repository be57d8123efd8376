"""Names from outside (tracks, cameras, scenarios, members of records) as safe paths.

Such a name never becomes a path as it stands: `folder_name` makes one component of it, `member`
opens what a record names inside of its own folder.
"""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path, PurePosixPath

from recast.core.errors import InputError

_PLAIN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,99}")
_RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?")  # device names on Windows


def folder_name(name: str) -> str:
    """One path component for any name, the same each time; different names get different ones.

    Up to 100 letters, digits, `_ . + -` that do not begin with a dot or a dash stay as they are.
    Any other name gets its readable part and a hash, with `~` between, which plain names lack.
    """
    plain = _PLAIN.fullmatch(name) and not name.endswith(".") and not _RESERVED.fullmatch(name)
    if plain:
        return name
    readable = re.sub(r"[^A-Za-z0-9_-]+", "_", name)[:40].strip("_-") or "name"
    digest = hashlib.blake2b(name.encode("utf-8", "surrogatepass"), digest_size=8)
    return f"{readable}~{digest.hexdigest()}"


def member(folder: str | Path, name: str, where: str | Path, field: str) -> Path:
    """The path that a record names inside of `folder`.

    Links inside of the folder are followed: caches of downloaded files consist of them.

    Args:
        name: relative path, with `/` between components.
        where, field: record and member that name it, for messages.

    Raises:
        InputError: the name is empty, absolute, leads out of the folder or contains a NUL, a
            backslash or a character that no file name here can have, such as a lone surrogate.
    """
    path = PurePosixPath(name)
    wrong = not path.parts or path.is_absolute() or ".." in path.parts or len(name) > 4096
    wrong |= "\0" in name or "\\" in name or (len(name) > 1 and name[1] == ":")
    if wrong or not _is_file_name(name):
        raise InputError(
            where,
            field,
            f"names {name!r}, which is not a file inside of {Path(folder).name}/",
            "give a relative path below that folder",
        )
    return Path(folder) / path


def _is_file_name(name: str) -> bool:
    try:
        os.fsencode(name)
    except UnicodeEncodeError:
        return False
    return True
