"""Planners that learn from what they come to see."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from recast.cameras import CameraMount, PinholeCamera
from recast.core.errors import InputError
from recast.planning import BasePlanner, IdmLaneFollower, Plan, PlannerInput
from recast.simulation import NullRenderer, RolloutSettings, Simulator
from recast.studies import teaching
from recast.studies.teaching import (
    RECORD_FILE,
    SAMPLES_FILE,
    collect_samples,
    read_samples,
    train_in_the_loop,
)
from support.synthetic_drives import drive

MOUNTS = {
    name: CameraMount(PinholeCamera(8, 4, 5.0, 5.0, 4.0, 2.0), np.eye(4))
    for name in ("front", "front_left")
}


class Straight(BasePlanner):
    """Straight ahead at a share of the ego's speed, which it learns."""

    name = "straight"

    def __init__(self, needs_images: bool = False) -> None:
        self.share, self.rounds = 2.0, [0]
        self.needs_images = needs_images

    def plan(self, observation: PlannerInput) -> Plan:
        waypoints = np.zeros((40, 3))
        speed = self.share * float(observation.ego.vx)
        waypoints[:, 0] = speed * 0.1 * np.arange(1, 41)
        return Plan(waypoints)

    def learn(self, samples: Sequence[Path]) -> None:
        told = read_samples(samples)
        self.rounds.append(len(told))
        wanted, speed = told.expert[:, -1, 0] / 4.0, told.status[:, 4].astype(np.float64)
        weights = told.balanced
        self.share = float((weights * wanted * speed).sum() / (weights * speed**2).sum())


def simulator(motion: str = "stationary-a", steps: int = 10) -> Simulator:
    return Simulator(drive(), actors={"7": motion}, settings=RolloutSettings(steps=steps))


def test_it_learns_what_the_expert_does(tmp_path: Path) -> None:
    """From the expert's states first, from its own then; all of them are kept."""
    planner = Straight()
    made = train_in_the_loop(
        planner, lambda _: [simulator, simulator], tmp_path, rounds=2, expert="idm-follower"
    )
    assert 0.0 < planner.share < 1.1  # IDM brakes for what stands
    assert [[one.driver for one in part] for part in made] == [["expert"] * 2, ["planner"] * 2]
    assert planner.rounds == [0, 4, 8]  # of ten steps two plans each
    assert not any(one.failed for part in made for one in part)


def test_only_the_expert_is_told_what_comes(tmp_path: Path) -> None:
    told: dict[str, list[bool]] = {"planner": [], "expert": []}

    class Listening(Straight):
        def __init__(self, who: str) -> None:
            super().__init__()
            self.foresees, self.told = who == "expert", told[who]

        def plan(self, observation: PlannerInput) -> Plan:
            self.told.append(observation.actors[0].future is not None)
            return super().plan(observation)

    collect_samples(Listening("planner"), [simulator], tmp_path, expert=Listening("expert"))
    assert told == {"planner": [False, False], "expert": [True, True]}


def test_a_sample_says_what_was_seen_and_what_both_would_do(tmp_path: Path) -> None:
    planner = Straight()
    collect_samples(planner, [simulator], tmp_path, expert="idm-follower", expert_drives=1.0)
    told = read_samples([tmp_path])
    sim, expert = simulator(), IdmLaneFollower()
    expert.reset(sim.context)
    seen = sim.reset(seed=0)
    for row in range(2):
        np.testing.assert_allclose(told.expert[row], expert.plan(seen).waypoints, atol=1e-4)
        np.testing.assert_allclose(told.planner[row], planner.plan(seen).waypoints, atol=1e-4)
        assert told.status[row, 4] == np.float32(seen.ego.vx)
        x, y, heading, vx, vy, length, width, height = told.boxes[row][0]
        actor = seen.actors[0]
        here = seen.ego.pose
        turn = np.array([np.cos(here[2]), np.sin(here[2])])
        ahead = actor.pose[:2] - here[:2]
        assert x == pytest.approx(ahead @ turn, abs=1e-4)
        assert y == pytest.approx(turn[0] * ahead[1] - turn[1] * ahead[0], abs=1e-4)
        assert heading == pytest.approx(actor.pose[2] - here[2], abs=1e-4)
        assert (length, width, height) == pytest.approx(tuple(actor.size), abs=1e-5)
        assert np.hypot(vx, vy) == pytest.approx(np.hypot(*actor.velocity), abs=1e-4)
        seen = sim.step(expert.plan(seen))
    assert set(told.ahead) <= {"free", "leading", "oncoming", "crossing", "standing"}
    assert told.balanced.sum() == pytest.approx(1.0)


def test_images_are_kept_by_camera(tmp_path: Path) -> None:
    def seeing() -> Simulator:
        return Simulator(
            drive(),
            NullRenderer(MOUNTS),
            actors={"7": "cut-in-a"},
            settings=RolloutSettings(steps=5),
        )

    collect_samples(Straight(needs_images=True), [seeing], tmp_path, expert="idm-follower")
    told = read_samples([tmp_path])
    images = told.images(0)
    assert sorted(images) == ["front", "front_left"]
    assert images["front"].shape == (4, 8, 3)
    told.files[0]["front"].unlink()
    with pytest.raises(InputError, match="front"):
        told.images(0)


def test_what_fails_costs_its_own_samples_alone(tmp_path: Path) -> None:
    """A world that cannot be made, a planner and an expert that fail are told and counted."""

    class Lost(IdmLaneFollower):
        def plan(self, observation: PlannerInput) -> Plan:
            if observation.step == 0:
                raise ValueError("no route from here")
            return super().plan(observation)

    class Broken(Straight):
        def plan(self, observation: PlannerInput) -> Plan:
            if observation.step > 0:
                raise RuntimeError("no memory left")
            return super().plan(observation)

    def nowhere() -> Simulator:
        raise InputError("log", "track 7", "is missing", "choose another")

    found = collect_samples(Straight(), [nowhere, simulator], tmp_path / "a", expert=Lost())
    assert [(one.moments, one.unlabelled) for one in found] == [(0, 0), (1, 1)]
    assert "track 7" in found[0].failed
    assert not found[1].failed
    assert len(read_samples([tmp_path / "a"])) == 1
    found = collect_samples(Broken(), [simulator], tmp_path / "b", expert="idm-follower")
    assert found[0].moments == 1
    assert "no memory left" in found[0].failed
    collect_samples(Straight(), [nowhere], tmp_path / "c", expert="idm-follower")
    with pytest.raises(InputError, match="there are none"):
        read_samples([tmp_path / "c"])


def test_it_goes_on_where_it_was_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    episodes = [lambda motion=motion: simulator(motion) for motion in ("cut-in-a", "oncoming-a")]
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    collect_samples(Straight(), episodes, whole, expert="idm-follower", expert_drives=0.5)
    written = teaching.write_parquet

    def killed(path: Path, table: object) -> None:
        if path.parent.name.startswith("rollout-00001") or "00001" in str(path.parent):
            raise KeyboardInterrupt
        written(path, table)

    monkeypatch.setattr(teaching, "write_parquet", killed)
    with pytest.raises(KeyboardInterrupt):
        collect_samples(Straight(), episodes, parts, expert="idm-follower", expert_drives=0.5)
    assert [path.name for path in parts.glob("rollout-*")] == ["rollout-00000"]
    monkeypatch.undo()
    collect_samples(Straight(), episodes, parts, expert="idm-follower", expert_drives=0.5)
    for name in (SAMPLES_FILE, RECORD_FILE):
        for rollout in ("rollout-00000", "rollout-00001"):
            one, other = (root / rollout / name for root in (whole, parts))
            assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize(
    ("column", "cell"),
    [("boxes", [1.0] * 9), ("boxes", [None] * 8), ("images", "../front.png"), ("expert", [1.0])],
)
def test_damaged_samples_are_told(column: str, cell: Any, tmp_path: Path) -> None:
    collect_samples(Straight(), [simulator], tmp_path, expert="idm-follower")
    path = tmp_path / "rollout-00000" / SAMPLES_FILE
    table = pq.read_table(path)
    index = table.schema.get_field_index(column)
    cells = [*table.column(column).to_pylist()[:-1], cell]
    damaged = table.set_column(index, column, pa.array(cells, table.schema.field(index).type))
    pq.write_table(damaged, path)
    with pytest.raises(InputError, match=f"column {column}, row 1"):
        read_samples([tmp_path])


def test_bad_arguments_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="share from 0 to 1"):
        collect_samples(Straight(), [simulator], tmp_path, expert_drives=1.5)
    with pytest.raises(InputError, match="rounds"):
        train_in_the_loop(Straight(), lambda _: [], tmp_path, rounds=0)
    with pytest.raises(InputError, match="pdm-open"):
        collect_samples(Straight(), [simulator], tmp_path, expert="pdm-open")
