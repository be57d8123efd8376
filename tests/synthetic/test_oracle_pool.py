"""Processes that render: what becomes of them when they cannot start."""

from __future__ import annotations

import subprocess
import sys

_UNGUARDED = """
from recast.core.errors import InputError
from recast.synthetic.oracle import OraclePool

with OraclePool(bytes(5_000_000), workers=2) as pool:
    try:
        list(pool.map(len, [1, 2]))
    except InputError as error:
        print(error)
"""


def test_a_script_that_cannot_be_imported_anew_is_told_and_does_not_hang() -> None:
    """Read from standard input, it has no file that the processes could start from."""
    done = subprocess.run(
        [sys.executable, "-"], input=_UNGUARDED, capture_output=True, text=True, timeout=60
    )
    assert "guard a script's start" in done.stdout
