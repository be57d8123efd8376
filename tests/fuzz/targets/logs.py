"""Stored logs and maps."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from fuzz.target import Target
from fuzz.targets.importers import taste
from logs.small_log import small_log
from recast.logs import read_log, write_log
from recast.logs.importers.argoverse2 import load_argoverse2
from recast.logs.map_json import read_map, write_map
from support import tiny_argoverse2


def _write_log(folder: Path) -> None:
    write_log(small_log(np.random.default_rng(0)), folder / "log")


def _write_map(folder: Path) -> None:
    with tempfile.TemporaryDirectory() as root:
        tiny_argoverse2.write_tiny_log(Path(root))
        found = load_argoverse2(Path(root), tiny_argoverse2.LOG).map
    assert found is not None
    write_map(found, folder / "map.json")


TARGETS = (
    Target("log", _write_log, lambda folder, out: taste(read_log(folder / "log")), weight=3.0),
    Target(
        "log-record",
        _write_log,
        lambda folder, out: taste(read_log(folder / "log")),
        files=("*.json",),
        weight=3.0,
    ),
    Target("map", _write_map, lambda folder, out: read_map(folder / "map.json").lanes, weight=1.5),
)
