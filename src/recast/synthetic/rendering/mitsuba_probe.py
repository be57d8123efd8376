"""Finds out whether mitsuba runs here, without risking this process: a wrong LLVM aborts it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

from recast.errors import InputError

VARIANT = "llvm_ad_rgb"
LIBRARY = "DRJIT_LIBLLVM_PATH"
"""Environment variable that tells mitsuba which LLVM to load."""

_TRIAL = f"""
import mitsuba
mitsuba.set_variant({VARIANT!r})
scene = mitsuba.load_dict({{"type": "scene", "shape": {{"type": "sphere"}}}})
ray = mitsuba.Ray3f(mitsuba.Point3f(0, 0, -3), mitsuba.Vector3f(0, 0, 1))
assert scene.ray_test(ray)[0]
"""
_FOLDERS = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib",
            "/opt/homebrew/opt/llvm/lib")  # fmt: skip


@lru_cache(maxsize=1)
def working_llvm() -> str | None:
    """Path of an LLVM that mitsuba runs with; None where its own choice works.

    Raises:
        InputError: mitsuba is not installed, or runs with no LLVM found.
    """
    missing = subprocess.run(
        [sys.executable, "-c", "import mitsuba"], capture_output=True, check=False
    ).returncode
    if missing:
        raise InputError(
            "quality 'mitsuba'", "mitsuba", "is not installed", "pip install 'recast-sim[mitsuba]'"
        )
    tried: list[str | None] = [None] if os.environ.get(LIBRARY) else [*_libraries(), None]
    for library in tried:
        environment = dict(os.environ) | ({} if library is None else {LIBRARY: library})
        trial = subprocess.run(
            [sys.executable, "-c", _TRIAL], env=environment, capture_output=True, check=False
        )
        if trial.returncode == 0:
            return library
    raise InputError(
        "quality 'mitsuba'",
        "LLVM",
        "mitsuba runs with none of the libraries found",
        f"install LLVM 16 or newer (Debian: apt install libllvm19) or set {LIBRARY}",
    )


def _libraries() -> list[str]:
    """LLVM libraries of version 16 and later, newest first; older ones are known to abort."""
    found: dict[int, str] = {}
    for folder in _FOLDERS:
        for path in sorted(Path(folder).glob("libLLVM*")):
            version = re.search(r"libLLVM[-.](?:so\.)?(\d+)", path.name)
            if version and int(version[1]) >= 16:
                found[int(version[1])] = str(path)
    return [found[version] for version in sorted(found, reverse=True)]
