"""Scenarios, rollouts, run folders and their configurations."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from fuzz.target import Target
from recast.actors.actor import NOTHING, Coverage
from recast.core.files import write_json
from recast.geometry import se3
from recast.logs.hdmap import HdMap, Lane
from recast.logs.importers.nuscenes import KEY_FRAMES
from recast.metrics.trust import packaged_calibration, read_calibration, write_calibration
from recast.planning import ShownView
from recast.runs.arms import parse_arms
from recast.runs.config import RunConfig, read_run_config
from recast.runs.rollouts import given_views
from recast.runs.run_folder import RunFolder, use_name
from recast.simulation import MOTIONS, load_rollout, save_rollout, scenario_record
from recast.simulation.rollout_files import load_coverage, save_coverage
from recast.simulation.scenario import read_scenario
from recast.simulation.scene_renderer import ImageCoverage, RolloutCoverage
from recast_bridges.neuroncap.scenario_file import read_ncap_scenario
from recast_bridges.neuroncap.scenarios import ncap_runs
from recast_bridges.openx import (
    Entity,
    Played,
    read_opendrive,
    read_openscenario,
    write_opendrive,
    write_openscenario,
)
from support.made_up_rollouts import make_rollout
from support.tiny_served import make_log

_COVERAGE = RolloutCoverage(
    (
        ImageCoverage("front", 0, True, Coverage(40.0, 0.5, 0.25, 0.25)),
        ImageCoverage("side", 5, False, NOTHING),
    )
)
_VIEW = ShownView("front", "camera", "camera", False, 1.0, 96, 64)
_LINE = np.array([[0.0, 0, 0], [5, 1, 0], [10, 0, 1]])
_SIDE = np.array([0.0, 2, 0])
_LANE = Lane("1", _LINE, _LINE + _SIDE, _LINE - _SIDE, _LINE[:, :2], 9.0)
_CAR = Entity(
    *("1", "car", np.array([4.0, 2, 1.5]), np.array([1.0, 0, 0.7])),
    *(np.arange(4) * 0.1, se3.exp(np.zeros((4, 6))), 1.0),
)
_PLAYED = Played("cut-in", "", 0.3, (_CAR,))
_NCAP = """\
general: {start-frame: 3, priming-steps: 2, duration: 7.0, start-jitter: 1, start-pose: original}
actors:
  - uuids: [car-a, car-a]
    flip-uuids: [car-a]
    mode: override
    times: [-1.0, 4.0, 20.0]
    is_target_actor: true
    initial-yaw: -2.1
    positions: [[5.0, 20.0, 0.0], [40.0, 0.0, 0.0], [40.0, 0.0, 0.0]]
    jitter: {longitudinal: 1.0, lateral: 0.5, long-lat-angle: -2.1, yaw-jitter: 0.3}
  - {uuid: car-b, mode: optimized, exclusive-group: "1"}
"""
_ARMS = """\
- {name: ours, vehicle: generated, generator: template, refine: false, views: 3}
- name: "true street"
  street: truth
  vehicle: generated
  noise: grey
"""
_NCAP_LOG = replace(
    make_log(), metadata={KEY_FRAMES: " ".join(str(5_000_000 + 500_000 * k) for k in range(40))}
)
_SCENARIOS = Path(__file__).parents[3] / "src" / "recast" / "simulation" / "scenarios"


def _write_scenario(folder: Path) -> None:
    (folder / "my.yaml").write_bytes((_SCENARIOS / "cut-in.yaml").read_bytes())


def _config() -> RunConfig:
    own = scenario_record(MOTIONS["cut-in-a"]) | {"name": "own"}
    return RunConfig(track="0", motions=("own-a", "stationary-a"), own_motions={"own-a": own})


def _write_run(folder: Path) -> None:
    run = RunFolder.create_or_resume(
        folder / "run", _config().resolved(), folder / "log", "0" * 32, str(folder / "store")
    )
    store = run.store()
    made = store.make("scenes", {"log": "0" * 32}, _write_artefact, name="street")
    run.refer(store, {use_name("scene", "recast"): made}, whole=True)


def _write_artefact(folder: Path) -> None:
    (folder / "scene.json").write_text("{}")


def _open_run(folder: Path) -> None:
    """What `recast report` and `recast store` do with a run folder and its store."""
    run = RunFolder.open(folder / "run")
    assert run.config
    store = run.store()
    for use in run.record.artefacts:
        run.artefact(store, use)
    store.unused()


TARGETS = (
    Target("scenario", _write_scenario, lambda f, out: read_scenario(f / "my.yaml"), weight=10.0),
    Target(
        "ncap-scenario",
        lambda f: (f / "0103.yaml").write_text(_NCAP),
        lambda f, out: ncap_runs(read_ncap_scenario(f / "0103.yaml"), _NCAP_LOG, 4),
        weight=10.0,
    ),
    Target(
        "arms",
        lambda f: (f / "arms.yaml").write_text(_ARMS),
        lambda f, out: parse_arms([str(f / "arms.yaml")]),
        weight=8.0,
    ),
    Target(
        "run-config",
        lambda f: write_json(f / "config.json", _config().resolved()),
        lambda f, out: read_run_config(f / "config.json"),
        weight=10.0,
    ),
    Target("run-folder", _write_run, lambda f, out: _open_run(f), weight=6.0),
    Target(
        "coverage",
        lambda f: save_coverage(_COVERAGE, f / "coverage.parquet"),
        lambda f, out: load_coverage(f / "coverage.parquet"),
        weight=6.0,
    ),
    Target(
        "trust-calibration",
        lambda f: write_calibration(packaged_calibration(), f / "trust.json"),
        lambda f, out: read_calibration(f / "trust.json"),
        weight=4.0,
    ),
    Target(
        "planner-views",
        lambda f: write_json(f / "planner.json", {"planner": "p", "views": [asdict(_VIEW)]}),
        lambda f, out: given_views(f),
        weight=2.0,
    ),
    Target(
        "rollout",
        lambda f: save_rollout(make_rollout(steps=20), f / "states"),
        lambda f, out: load_rollout(f / "states"),
        weight=8.0,
    ),
    Target(
        "openscenario",
        lambda f: write_openscenario(f / "a.xosc", _PLAYED, "map.xodr"),
        lambda f, out: read_openscenario(f / "a.xosc"),
        weight=6.0,
    ),
    Target(
        "opendrive",
        lambda f: write_opendrive(f / "a.xodr", HdMap({"1": _LANE}, ()), "map"),
        lambda f, out: read_opendrive(f / "a.xodr"),
        weight=6.0,
    ),
)
