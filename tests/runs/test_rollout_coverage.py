"""Rollouts of an actor with shares: their coverage, in metrics.json and on the page."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from recast.actors.actor import CoverageMeter
from recast.core import Store
from recast.core.errors import InputError
from recast.planning import Plan, PlannerInput, PlanningContext
from recast.planning.simple import ProbePlanner
from recast.runs.artefacts import rollout_name
from recast.runs.config import RunConfig
from recast.runs.rollouts import make_rollout, read_coverage, read_rollout
from recast.runs.run_folder import METRICS_FILE
from recast.runs.scores import RunTrust, read_metrics, write_metrics
from recast.simulation import MOTIONS, Rollout, RolloutSetup
from recast.simulation.scene_renderer import SceneRenderer
from support.box_world import FACES, MOUNTS, SKY, box_log, box_shares, scene
from support.made_up_rollouts import street

LOG = box_log()
WHOLE = scene(tuple(FACES), LOG)
METER = CoverageMeter(WHOLE, "7", box_shares(WHOLE), "cpu")


class Watcher(ProbePlanner):
    """Drives straight on, and counts the images that show more than the sky."""

    needs_images = True

    def __init__(self) -> None:
        super().__init__("straight")
        self.shown = 0

    def reset(self, context: PlanningContext) -> None:
        super().reset(context)
        assert set(context.cameras) == {"front"}

    def plan(self, observation: PlannerInput) -> Plan:
        self.shown += bool((np.abs(observation.images["front"] / 255 - SKY) > 0.2).any())
        return super().plan(observation)


def drive(folder: Path, planner: ProbePlanner, filmed: bool, arm: str = "replaced") -> None:
    setup = RolloutSetup(
        LOG, "7", MOTIONS["stationary-a"], arm=arm, steps=20, camera_names=("front",)
    )
    renderer = SceneRenderer(WHOLE, MOUNTS, "cpu")
    meter = METER if arm == "replaced" else None
    make_rollout(setup, planner, renderer, folder, filmed=filmed, meter=meter)


@pytest.mark.parametrize("filmed", [False, True])
def test_images_of_the_planner_are_measured(filmed: bool, tmp_path: Path) -> None:
    planner = Watcher()
    drive(tmp_path / "r", planner, filmed)
    coverage = read_coverage(tmp_path / "r")
    assert coverage is not None and coverage.of_planner == coverage
    rollout = read_rollout(tmp_path / "r")
    assert isinstance(rollout, Rollout)
    assert [i.step for i in coverage.images] == rollout.plan_steps.tolist()
    assert coverage.visible == planner.shown > 0
    assert coverage.mean.invented > 0.9  # it faces the ego, and only rear and left are known


def test_films_of_a_planner_that_looks_at_nothing(tmp_path: Path) -> None:
    drive(tmp_path / "r", ProbePlanner("straight"), True)
    coverage = read_coverage(tmp_path / "r")
    assert coverage is not None and coverage.of_planner is None
    assert len(coverage.images) > 2


def test_metrics_have_the_means(tmp_path: Path) -> None:
    config = RunConfig(track="7", motions=("stationary-a",), planners=("p",))
    store, used = Store(tmp_path / "store"), {}
    for arm in config.arms:
        use = rollout_name("stationary-a", "p", arm.name)
        make = partial(drive, planner=Watcher(), filmed=False, arm=arm.name)
        used[use] = store.make("rollouts", {"use": use}, make, name=use)
    write_metrics(tmp_path / METRICS_FILE, config, used, street(), RunTrust(LOG, "7"))
    native, replaced = read_metrics(tmp_path / METRICS_FILE)["rollouts"]
    assert native["coverage"] is None
    measured = read_coverage(used[rollout_name("stationary-a", "p", "replaced")].path)
    assert measured is not None
    assert replaced["coverage"]["planner"] == replaced["coverage"]["all"]
    assert replaced["coverage"]["all"]["invented"] == measured.mean.invented
    assert replaced["coverage"]["all"]["images"] == len(measured.images)
    assert 0 < native["trust"]["value"] < 1
    assert native["trust"]["missing"]["seen"] == "the target's shares were not measured"
    assert replaced["trust"]["features"]["seen"] == pytest.approx(measured.mean.seen)
    assert "invented" in replaced["trust"]["words"] and "seen" not in replaced["trust"]["missing"]
    record = json.loads((tmp_path / METRICS_FILE).read_text())
    record["rollouts"][1]["coverage"]["all"]["seen"] = "most"
    (tmp_path / METRICS_FILE).write_text(json.dumps(record))
    with pytest.raises(InputError, match=r"rollouts.*coverage.*seen"):
        read_metrics(tmp_path / METRICS_FILE)
