"""What the command imports before it knows what to do: `recast --help` answers at once."""

from __future__ import annotations

import subprocess
import sys

_HELP = """
import sys
from recast.cli.main import main
try:
    main(["--help"])
except SystemExit:
    print(*sys.modules)
"""
_HEAVY = {"torch", "numpy", "scipy", "ncore", "pydantic", "rich", "upath", "matplotlib", "cv2"}


def test_help_imports_nothing_heavy() -> None:
    done = subprocess.run([sys.executable, "-c", _HELP], capture_output=True, text=True, check=True)
    imported = set(done.stdout.splitlines()[-1].split())
    assert "recast.cli.main" in imported
    assert not imported & _HEAVY
