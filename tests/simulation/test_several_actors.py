"""A target and further controlled actors in one rollout."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from recast.core.errors import InputError
from recast.geometry import boxes
from recast.logs.types import DrivingLog
from recast.metrics import rollout_metrics
from recast.metrics.table import script_difference
from recast.planning import ConstantVelocity, IdmLaneFollower, LogReplay
from recast.simulation import (
    MOTIONS,
    ControlledActor,
    Idm,
    Rollout,
    RolloutSettings,
    RolloutSetup,
    Simulator,
    load_rollout,
    prepare,
    run_rollout,
    save_rollout,
)
from recast.simulation.scene_renderer import rollout_coverage
from support.controlled_tracks import Bad, line, with_track
from support.recorders import CountingRenderer, Recorder
from support.synthetic_drives import drive

ACTORS = {
    "lead": Idm("lead", speed=0.5, gap=45.0),
    "tail": MOTIONS["idm-a"],
    "passing": MOTIONS["log-replay-a"],
}


def busy(seconds: float = 20.0) -> DrivingLog:
    log = with_track(drive(seconds=seconds), "lead", line((20.0, -12.0, 0.0), 2.0))
    log = with_track(log, "tail", line((-8.0, 0.0, 0.0), 10.0))
    return with_track(log, "passing", line((0.0, 3.5, 0.0), 12.0))


@pytest.fixture(scope="module")
def setup() -> RolloutSetup:
    return RolloutSetup(
        busy(), "7", MOTIONS["cut-in-stop-a"], start_timestamp_us=6_200_000, steps=60, actors=ACTORS
    )


@pytest.fixture(scope="module")
def rollout(setup: RolloutSetup) -> Rollout:
    return run_rollout(setup, IdmLaneFollower())


def test_two_that_react_a_replay_and_the_target(setup: RolloutSetup, rollout: Rollout) -> None:
    assert rollout.steps_run == 60
    assert [actor.track_id for actor in rollout.controlled] == list(ACTORS)
    assert [actor.motion for actor in rollout.controlled] == ["idm", "idm", "log-replay"]
    assert [actor.setting for actor in rollout.controlled] == ["lead", "a", "a"]
    assert rollout.reactive == ("lead", "tail")
    alone = run_rollout(replace(setup, actors={}), ConstantVelocity())
    assert rollout.actor.tobytes() == alone.actor.tobytes()
    assert rollout.world_from_actor.tobytes() == alone.world_from_actor.tobytes()
    users = [(rollout.ego_boxes, rollout.ego_size), (rollout.actor, rollout.actor_size)]
    users += [(actor.states, actor.size) for actor in rollout.controlled]
    for i, (one, size) in enumerate(users):
        for other, other_size in users[i + 1 :]:
            assert boxes.bev_overlap_area(one[:, :3], size, other[:, :3], other_size).max() == 0.0


def test_further_actors_react_to_the_ego_and_to_each_other(setup: RolloutSetup) -> None:
    def last_speed(actors: dict[str, object], planner: object = None) -> float:
        changed = replace(setup, actors=actors)  # type: ignore[arg-type]
        made = run_rollout(changed, planner or ConstantVelocity())  # type: ignore[arg-type]
        return next(float(a.states[-1, 3]) for a in made.controlled if a.track_id == "tail")

    class Stop(Recorder):
        def plan(self, observation):
            plan = super().plan(observation)
            return replace(plan, waypoints=0.0 * plan.waypoints)

    assert last_speed({"tail": ACTORS["tail"]}, Stop()) < 0.5
    assert last_speed({"tail": ACTORS["tail"]}) > 7.0
    ahead = {"tail": Idm("t", gap=15.0, lateral=-3.5), "lead": Idm("l", gap=30.0, lateral=-3.5)}
    slow = ahead | {"lead": replace(ahead["lead"], speed=0.1)}
    assert last_speed(slow) < last_speed(ahead)


def test_planners_see_the_target_then_the_further_ones_then_the_logged(setup: RolloutSetup) -> None:
    planner, renderer = Recorder(needs_images=True), CountingRenderer()
    kept = replace(setup, traffic="replay", camera_names=("front",), steps=10)
    made = run_rollout(kept, planner, renderer)
    seen = planner.seen[-1].actors
    assert [actor.track_id for actor in seen] == ["7", "lead", "tail", "passing", "9"]
    np.testing.assert_array_equal(seen[1].pose, made.controlled[0].states[5, :3])
    assert made.other_actors == ("9",)
    state = renderer.states[-1]
    assert set(state.poses) == {"7", "lead", "tail", "passing", "9"}
    assert list(state.actors) == ["7", "lead", "tail", "passing"]
    [other] = made.traffic
    np.testing.assert_array_equal(state.others["9"], other.world_from_actor[5])
    np.testing.assert_array_equal(made.state(5).others["9"], other.world_from_actor[5])
    for actor in made.further:
        np.testing.assert_array_equal(state.poses[actor.track_id], actor.world_from_actor[5])
        moment = state.actors[actor.track_id]
        np.testing.assert_array_equal(moment.state, actor.states[5])
        assert moment.log_world_from_actor is not None
        # a box stands on the ground, here at z = 0
        np.testing.assert_allclose(actor.world_from_actor[:, 2, 3], actor.size[2] / 2)
        np.testing.assert_allclose(actor.world_from_actor[:, :2, 3], actor.states[:, :2])


def test_it_reads_back_bit_for_bit(rollout: Rollout, tmp_path: Path) -> None:
    save_rollout(rollout, tmp_path / "r")
    back = load_rollout(tmp_path / "r")
    assert back.reactive == rollout.reactive
    assert back.origin is None
    for one, other in zip(rollout.controlled, back.controlled, strict=True):
        for name in ("states", "world_from_actor", "size"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
        for name in ("track_id", "category", "motion", "setting"):
            assert getattr(one, name) == getattr(other, name)
    save_rollout(back, tmp_path / "again")
    for file in sorted((tmp_path / "r").iterdir()):
        assert file.read_bytes() == (tmp_path / "again" / file.name).read_bytes()


def test_alone_the_target_leaves_the_files_that_it_always_left(
    setup: RolloutSetup, tmp_path: Path
) -> None:
    save_rollout(run_rollout(replace(setup, actors={}), ConstantVelocity()), tmp_path / "r")
    names = sorted(file.name for file in (tmp_path / "r").iterdir())
    assert names == ["plans.parquet", "rollout.json", "rollout.parquet", "route.parquet"]
    header = (tmp_path / "r" / "rollout.json").read_text()
    assert "controlled" not in header and "reactive" not in header


def test_a_damaged_table_of_actors_is_refused(rollout: Rollout, tmp_path: Path) -> None:
    save_rollout(rollout, tmp_path / "r")
    path = tmp_path / "r" / "actors.parquet"
    table = pq.read_table(path)
    pq.write_table(table.slice(1), path)
    with pytest.raises(InputError, match=r"Rollout.controlled\['lead'\].states: expected"):
        load_rollout(tmp_path / "r")
    path.unlink()
    with pytest.raises(InputError, match=r"actors\.parquet"):
        load_rollout(tmp_path / "r")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"states": np.zeros((3, 4))}, r"states: expected \(61, 4\), got \(3, 4\)"),
        ({"size": np.zeros(3)}, "size: is"),
        ({"states": -np.ones((61, 4))}, "negative speed"),
        ({"states": np.full((61, 4), np.nan)}, "holds NaN"),
        ({"world_from_actor": np.ones((61, 4, 4))}, "world_from_actor"),
        ({"track_id": "7"}, "has a track twice"),
        ({"motion": "x" * 2000}, "motion: has 2000 characters, more than 1000"),
    ],
)
def test_what_is_no_controlled_actor(
    rollout: Rollout, change: dict[str, object], message: str
) -> None:
    first: ControlledActor = replace(rollout.controlled[0], **change)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=message):
        replace(rollout, controlled=(first, *rollout.controlled[1:])).validate()


def test_the_first_steps_alone(rollout: Rollout) -> None:
    first = rollout.first(20)
    first.validate()
    assert all(len(actor.states) == 21 for actor in first.controlled)


def test_metrics_count_every_controlled_actor(setup: RolloutSetup) -> None:
    lead = {"lead": replace(ACTORS["lead"], gap=20.0, speed=0.1)}
    clear = replace(setup, motion=MOTIONS["advancing-b"])
    hit = run_rollout(replace(clear, actors=lead), ConstantVelocity())
    found = rollout_metrics(hit, None)
    assert (found.collision.nc.value, found.collisions["7"].nc.value) == (0.0, 1.0)
    first = found.collisions["lead"].first_step
    assert found.collision.first_step == first
    assert (
        found.collision.nc.reason == f"overlaps actor lead from step {first} ({first * 0.1:.1f} s)"
    )
    assert "meets actor lead after 0.0 s" in str(found.ttc.ttc.reason)
    assert found.progress.r_c.reason is not None and "collision" in found.progress.r_c.reason
    steps = found.to_json()["per_step"]["first_collision_step_of"]
    assert steps == {"7": None, "lead": first}
    alone = rollout_metrics(run_rollout(replace(clear, actors={}), ConstantVelocity()), None)
    assert alone.collision.nc.value == 1.0
    assert "first_collision_step_of" not in alone.to_json()["per_step"]
    same = rollout_metrics(replace(hit, controlled=()), None)
    assert same.ttc.per_cycle.tolist() == alone.ttc.per_cycle.tolist()


def test_methods_may_differ_in_what_reactive_actors_do(
    setup: RolloutSetup, rollout: Rollout
) -> None:
    other = run_rollout(setup, ConstantVelocity())
    assert not np.array_equal(other.controlled[1].states, rollout.controlled[1].states)
    assert script_difference(rollout, other) is None
    late = replace(rollout.controlled[2], states=rollout.controlled[2].states + 1.0)
    moved = replace(rollout, controlled=(*rollout.controlled[:2], late))
    assert script_difference(rollout, moved) == "actor passing's states differ from step 0 on"
    fewer = replace(rollout, controlled=rollout.controlled[:2])
    assert script_difference(rollout, fewer) == "the controlled actors differ"


def test_all_controlled_actors_hide_each_other_in_the_coverage(setup: RolloutSetup) -> None:
    class Meter:
        poses: list[set[str]] = []  # noqa: RUF012

        def measure(self, camera, camera_from_world, poses, shown=None):
            from recast.actors.actor import NOTHING

            self.poses.append(set(poses))
            return NOTHING

    renderer, meter = CountingRenderer(), Meter()
    made = run_rollout(replace(setup, steps=10), ConstantVelocity())
    rollout_coverage(made, meter, renderer.mounts, (), ("front",))
    assert meter.poses == [{"7", "lead", "tail", "passing"}] * 2


def test_a_reactive_actor_that_leaves_cuts_for_all(setup: RolloutSetup) -> None:
    fast = replace(setup, actors={"lead": Idm("f", speed=3.0, gap=90.0)}, steps=120)
    made = run_rollout(fast, ConstantVelocity())
    assert made.steps_run < 120
    assert str(made.cut_reason).startswith("actor lead would leave the recorded road: it would be")
    assert len(made.controlled[0].states) == len(made.ego) == len(made.actor)
    assert made.plan_steps[-1] < made.steps_run


def test_prepare_shows_them_with_the_ego_as_recorded(setup: RolloutSetup) -> None:
    prepared = prepare(setup)
    assert [actor.track_id for actor in prepared.further] == list(ACTORS)
    driven = run_rollout(setup, LogReplay())
    for actor, other in zip(prepared.further, driven.controlled, strict=True):
        # the tracker lags a little behind the log
        np.testing.assert_allclose(actor.states, other.states, atol=0.3)


@pytest.mark.parametrize(
    ("actors", "message"),
    [
        ({"7": MOTIONS["cut-in-a"]}, "actors: track 7 is given twice"),
        ({"none": MOTIONS["idm-a"]}, "track none: is not in the log; choose one of 7, 9, lead"),
        ({"lead": "idm"}, "motion of track lead: str: is not a motion"),
        ({"lead": Idm("a", gap=-3.0)}, "actor lead and ego overlap by .* at the start"),
        (
            {"lead": Idm("a", gap=20.0), "tail": Idm("b", gap=22.0)},
            "actor tail and actor lead overlap by",
        ),
        (
            {"lead": replace(MOTIONS["advancing-a"], gap=10.0)},
            "actor lead and actor overlap by",
        ),
        ({"lead": Idm("a", gap=400.0)}, "actor lead would leave the recorded road"),
        ({"lead": Bad(np.zeros(2), 3)}, "motion bad: its state 3 is"),
    ],
)
def test_bad_actors_are_one_line(
    setup: RolloutSetup, actors: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message) as error:
        run_rollout(replace(setup, actors=actors), ConstantVelocity())  # type: ignore[arg-type]
    assert "\n" not in str(error.value)


def test_a_simulator_takes_them_in_order() -> None:
    sim = Simulator(
        busy(),
        actors={"7": "cut-in", **ACTORS},
        settings=RolloutSettings(start_timestamp_us=6_200_000, steps=10),
    )
    assert [actor.track_id for actor in sim.reset().actors] == ["7", *ACTORS]
    assert sim.setup.track_id == "7"
