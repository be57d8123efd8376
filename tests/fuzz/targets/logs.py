"""Stored logs and maps."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from fuzz.target import Target
from fuzz.targets.importers import taste
from recast.logs import read_log, write_log
from recast.logs.hdmap import read_map, write_map
from recast.logs.importers.argoverse2 import load_argoverse2
from recast_bridges.alpasim import export_bundle, load_alpasim
from recast_bridges.alpasim.bundle import read_usdz, write_usdz
from support import tiny_argoverse2
from support.small_log import small_log


def _write_log(folder: Path) -> None:
    write_log(small_log(np.random.default_rng(0)), folder / "log")


def _write_map(folder: Path) -> None:
    with tempfile.TemporaryDirectory() as root:
        tiny_argoverse2.write_tiny_log(Path(root))
        found = load_argoverse2(Path(root), tiny_argoverse2.LOG).map
    assert found is not None
    write_map(found, folder / "map.json")


BUNDLE = "bundle.usdz"
MEMBERS = ("metadata.yaml", "rig_trajectories.json", "sequence_tracks.json", "recast_map.json")


def _write_bundle(folder: Path) -> None:
    _write_map(folder)
    log = replace(small_log(np.random.default_rng(0)), map=read_map(folder / "map.json"))
    (folder / "map.json").unlink()
    export_bundle(log, folder / BUNDLE)


def _write_members(folder: Path) -> None:
    """The members of a bundle as files: inside of the archive, its checksums would hide damage."""
    _write_bundle(folder)
    for name, data in read_usdz(folder / BUNDLE, dict.fromkeys(MEMBERS, 1 << 26)).items():
        (folder / name).write_bytes(data)
    (folder / BUNDLE).unlink()


def _read_members(folder: Path) -> object:
    with tempfile.TemporaryDirectory() as packed:
        bundle = Path(packed) / BUNDLE
        write_usdz(bundle, {name: (folder / name).read_bytes() for name in MEMBERS})
        return taste(load_alpasim(bundle))


TARGETS = (
    Target("log", _write_log, lambda folder, out: taste(read_log(folder / "log")), weight=3.0),
    Target(
        "log-record",
        _write_log,
        lambda folder, out: taste(read_log(folder / "log")),
        files=("*.json",),
        weight=3.0,
    ),
    Target("bundle", _write_bundle, lambda folder, out: taste(load_alpasim(folder / BUNDLE))),
    Target("bundle-members", _write_members, lambda folder, out: _read_members(folder)),
    Target("map", _write_map, lambda folder, out: read_map(folder / "map.json").lanes, weight=1.5),
)
