"""`recast doctor` looks around; it neither loads torch nor breaks where something is missing."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from recast.actors import DEFAULT_GENERATOR, DEFAULT_SEGMENTER
from recast.cli.main import main
from recast.cli.rows import machine
from recast.core import workers
from recast.core.plugins import GENERATORS, PLANNERS, SEGMENTERS
from recast.planning import GTRS_MINI

_LISTED = """
import sys
from recast.cli.rows import machine
machine._loads = lambda library: False  # as without a driver
machine.examine()
print(*sys.modules)
"""


def test_nothing_heavy_is_imported_without_a_driver() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _LISTED], capture_output=True, text=True, check=True
    )
    imported = set(done.stdout.split())
    assert "recast.kernel" in imported
    assert not imported & {"torch", "numpy", "scipy", "ncore", "pyarrow", "recast.planning"}


def test_it_lists_the_parts_and_the_kernel(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    for word in ("gtrs-mini", "recast-mini", "box-lidar", "waymo-v2", "CPU kernel", "cores"):
        assert word in shown


def test_experimental_importers_are_marked() -> None:
    [found] = [finding for finding in machine.examine() if finding.part == "importers"]
    assert "kitti, nuscenes (experimental)" in found.detail


def test_the_names_of_built_in_parts_are_those_that_the_rest_uses() -> None:
    assert GTRS_MINI in PLANNERS.names()
    assert DEFAULT_GENERATOR in GENERATORS.names()
    assert DEFAULT_SEGMENTER in SEGMENTERS.names()


def test_a_missing_package_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_EXTRAS", {"rare": (("numpy", "no-such-package"), "a purpose")})
    [found] = [finding for finding in machine.examine() if finding.part == "extra rare"]
    assert (found.present, found.detail) == (False, "a purpose")
    assert found.mend == "pip install 'recast-sim[rare]'"


def test_every_extra_is_listed() -> None:
    text = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    extras = tomllib.loads(text)["project"]["optional-dependencies"]
    assert machine._EXTRAS.keys() == extras.keys()
    for extra, (packages, purpose) in machine._EXTRAS.items():
        needed = " ".join(extras[extra])
        assert purpose and all(name in needed or f"[{extra}]" in needed for name in packages)


def test_cores_where_no_system_call_tells_the_share(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)  # as on macOS and Windows
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    assert workers.usable_cores() == 6
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert workers.usable_cores() == 1
