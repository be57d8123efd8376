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
_PLANNERS = """
import sys, recast.simulation
from recast.planning import make_planner
make_planner("alpasim:localhost:6789/front")
print(*sys.modules)
"""
_SCENARIOS = """
import sys
from recast.cli.main import main
assert main(["scenario", "list"]) == 0
print(*sys.modules)
"""
_HEAVY = {"torch", "numpy", "scipy", "ncore", "pydantic", "rich", "upath", "matplotlib", "cv2"} | {
    "grpc",
    "google.protobuf",
}


def test_help_imports_nothing_heavy() -> None:
    done = subprocess.run([sys.executable, "-c", _HELP], capture_output=True, text=True, check=True)
    imported = set(done.stdout.splitlines()[-1].split())
    assert "recast.cli.main" in imported
    assert not imported & _HEAVY


def test_the_simulation_and_a_driver_need_neither_torch_nor_grpc_before_a_session() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _PLANNERS], capture_output=True, text=True, check=True
    )
    imported = set(done.stdout.split())
    assert {"recast.simulation", "recast_bridges.alpasim.driver"} <= imported
    assert not imported & {"torch", "grpc"}


def test_scenarios_are_listed_without_torch() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _SCENARIOS], capture_output=True, text=True, check=True
    )
    imported = set(done.stdout.splitlines()[-1].split())
    assert "recast.simulation" in imported and "cut-in-a" in done.stdout
    assert not imported & {"torch", "grpc"}
