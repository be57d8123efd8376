"""ASAM's own checkers and schemas over what recast writes (`make asam` installs them)."""

from __future__ import annotations

import json
import os
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.logs.hdmap import HdMap
from recast.simulation import MOTIONS, RolloutSetup
from recast.synthetic.streets import make_street
from recast_bridges.alpasim import export_bundle
from recast_bridges.openx import export_openx, played_scenario
from support.synthetic_drives import drive

REPOSITORY = Path(__file__).parents[3]
SCRIPT = """
import json, logging, sys
import qc_opendrive.main, qc_openscenario.main
from qc_baselib import Configuration, Result
logging.disable(logging.CRITICAL)
found = {}
for path in sys.argv[1:]:
    checker = qc_opendrive.main if path.endswith("xodr") else qc_openscenario.main
    config, result = Configuration(), Result()
    config.set_config_param("InputFile", path)
    name, version = checker.constants.BUNDLE_NAME, checker.constants.BUNDLE_VERSION
    result.register_checker_bundle(name=name, description="", version=version)
    result.set_result_version(version=version)
    checker.run_checks(config, result)
    checks = result.get_checker_bundle_result(name).checkers
    found[path] = {
        "completed": [c.checker_id for c in checks if c.status.name == "COMPLETED"],
        "issues": [f"{c.checker_id}: {i.description}" for c in checks for i in c.issues],
    }
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def street() -> HdMap:
    """The map on which the checker found four gaps between connected lanes."""
    return make_street("urban-straight", np.random.default_rng(1), 150.0).map


def check(*files: Path) -> None:
    """Every file passes its schema and all other checks, without an issue of any level."""
    default = REPOSITORY / ".venv-asam" / "bin" / "python"
    python = Path(os.environ.get("RECAST_ASAM_PYTHON", default))
    if not python.is_file():
        pytest.skip(f"ASAM's checkers not found at {python}: make asam, or set RECAST_ASAM_PYTHON")
    command = [str(python), "-c", SCRIPT, *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for path, found in json.loads(done.stdout.splitlines()[-1]).items():
        assert found["issues"] == [], path
        assert any("valid_schema" in name for name in found["completed"]), path


def test_scenarios_and_maps(street: HdMap, tmp_path: Path) -> None:
    log = drive(seconds=12, curvature=0.01, slope=0.05)
    played = played_scenario(RolloutSetup(log, "7", MOTIONS["cut-in-a"], steps=20))
    exported, _ = export_openx([played], street, tmp_path / "out", "map")
    check(tmp_path / "out" / "map.xodr", tmp_path / "out" / exported[0].file)


def test_bundles(street: HdMap, tmp_path: Path) -> None:
    log = replace(drive(seconds=2), map=street)
    export_bundle(log, tmp_path / "a.usdz")
    with zipfile.ZipFile(tmp_path / "a.usdz") as archive:
        archive.extract("map.xodr", tmp_path)
    check(tmp_path / "map.xodr")
