from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from recast.cameras import CameraMount, View
from recast.core.errors import InputError
from recast.geometry import boxes, se2
from recast.planning import (
    ConstantVelocity,
    IdmLaneFollower,
    LogReplay,
    Plan,
    PlannerInput,
)
from recast.simulation import (
    MOTIONS,
    NullRenderer,
    PerfectController,
    Rollout,
    RolloutSetup,
    SimState,
    Simulator,
    Timings,
    prepare,
    run_rollout,
    save_rollout,
)
from recast.simulation.planner_calls import PlannerCalls
from support.recorders import MOUNTS, CountingRenderer, Recorder
from support.synthetic_drives import drive


def first_hit(rollout: Rollout) -> int | None:
    for k in range(rollout.steps_run + 1):
        area = boxes.bev_overlap_area(
            rollout.ego_boxes[k], rollout.ego_size, rollout.actor[k, :3], rollout.actor_size
        )
        if area > 1e-9:
            return k
    return None


def test_the_paper_s_loop_is_32_plans_and_160_steps() -> None:
    rollout = run_rollout(RolloutSetup(drive(), "7", MOTIONS["cut-in-a"]), LogReplay())
    assert rollout.steps_run == rollout.steps_requested == 160
    assert rollout.cut_reason is None
    np.testing.assert_array_equal(rollout.plan_steps, 5 * np.arange(32))
    assert rollout.predictions.shape == (32, 40, 3)
    rollout.validate()


def test_a_collision_does_not_stop_it() -> None:
    setup = RolloutSetup(drive(seconds=25), "7", MOTIONS["stationary-a"])
    rollout = run_rollout(setup, ConstantVelocity())
    assert first_hit(rollout) is not None
    assert rollout.steps_run == 160


@pytest.mark.parametrize("curvature", [0.0, 0.01, -0.012])
def test_log_replay_through_the_lqr_stays_within_30_cm(curvature: float) -> None:
    setup = RolloutSetup(drive(curvature=curvature), "7", MOTIONS["advancing-a"])
    rollout = run_rollout(setup, LogReplay())
    gap = np.linalg.norm(rollout.ego[:, :2] - rollout.log_ego[:, :2], axis=1)
    assert gap.max() < 0.3


def test_the_perfect_controller_is_exact() -> None:
    setup = RolloutSetup(
        drive(curvature=0.01), "7", MOTIONS["advancing-a"], controller=PerfectController()
    )
    rollout = run_rollout(setup, LogReplay())
    # The replay needs 4 s of log ahead; here all of it lies within the log.
    kept = rollout.steps_run - 40
    np.testing.assert_allclose(rollout.ego[:kept, :2], rollout.log_ego[:kept, :2], atol=1e-9)
    np.testing.assert_allclose(
        se2.wrap_angle(rollout.ego[:kept, 2] - rollout.log_ego[:kept, 2]), 0.0, atol=1e-9
    )


@pytest.mark.parametrize("speed", [4.0, 7.0, 10.0, 13.0])
@pytest.mark.parametrize("name", ["stationary-a", "stationary-b", "cut-in-b", "oncoming-b"])
def test_the_idm_follower_avoids_what_can_be_avoided(name: str, speed: float) -> None:
    setup = RolloutSetup(drive(speed=speed, seconds=17), "7", MOTIONS[name])
    rollout = run_rollout(setup, IdmLaneFollower())
    assert first_hit(rollout) is None
    assert rollout.ego[:, 3].min() > -0.05


@pytest.mark.parametrize("speed", [4.0, 8.0, 12.0])
@pytest.mark.parametrize("name", ["cut-in-a", "oncoming-a"])
def test_the_idm_follower_avoids_the_tight_settings_up_to_their_reference_speed(
    name: str, speed: float
) -> None:
    # Above 12 m/s cut-in a closes its 6 m gap before its sideways motion shows.
    setup = RolloutSetup(drive(speed=speed, seconds=17), "7", MOTIONS[name], steps=100)
    assert first_hit(run_rollout(setup, IdmLaneFollower())) is None


def test_the_idm_follower_overtakes_the_advancing_car() -> None:
    setup = RolloutSetup(drive(speed=10.0, seconds=20), "7", MOTIONS["advancing-a"])
    rollout = run_rollout(setup, IdmLaneFollower())
    assert first_hit(rollout) is None
    assert rollout.ego[-1, 0] > rollout.actor[-1, 0] + 5.0


def test_the_end_of_the_log_cuts_with_a_reason() -> None:
    setup = RolloutSetup(drive(seconds=8), "7", MOTIONS["cut-in-a"])
    rollout = run_rollout(setup, IdmLaneFollower())
    assert rollout.steps_run == 80
    assert rollout.steps_requested == 160
    assert rollout.cut_reason == "the log ends 8.0 s after the start"


def test_the_end_of_the_road_cuts_where_the_ego_would_leave_it() -> None:
    log = drive(speed=10, seconds=20)
    poses = log.world_from_rig.poses.copy()
    poses[:, 0, 3] = np.minimum(poses[:, 0, 3], 60 + 0.2 * np.arange(len(poses)))
    slow = replace(log, world_from_rig=replace(log.world_from_rig, poses=poses))
    rollout = run_rollout(RolloutSetup(slow, "7", MOTIONS["cut-in-a"]), ConstantVelocity())
    length = 60 + 0.2 * 200
    assert rollout.cut_reason is not None
    assert "the ego would leave the recorded road" in rollout.cut_reason
    assert length - 3.1 < rollout.ego[-1, 0] <= length - 2.0
    assert rollout.plan_steps[-1] < rollout.steps_run
    assert len(rollout.actor) == len(rollout.log_ego) == rollout.steps_run + 1


def test_an_ego_at_the_end_of_the_road_is_refused() -> None:
    log = drive(speed=10, seconds=20)
    poses = log.world_from_rig.poses.copy()
    poses[:, 0, 3] = np.minimum(poses[:, 0, 3], 30 + 0.05 * np.arange(len(poses)))
    slow = replace(log, world_from_rig=replace(log.world_from_rig, poses=poses))
    setup = RolloutSetup(
        slow,
        "7",
        replace(MOTIONS["stationary-a"], min_gap=1.0, reserve=-40.0),
        start_timestamp_us=5_000_000 + 2_900_000,
    )
    with pytest.raises(InputError, match=r"the ego would leave the recorded road.* of 160 steps"):
        run_rollout(setup, ConstantVelocity())


def test_the_actor_is_the_same_for_every_planner_method_and_controller() -> None:
    rollouts = [
        run_rollout(
            RolloutSetup(drive(), "7", MOTIONS["cut-in-b"], arm=arm, controller=controller),
            planner,
        )
        for arm, planner, controller in [
            ("native", LogReplay(), PerfectController()),
            (
                "recast",
                IdmLaneFollower(),
                RolloutSetup(drive(), "7", MOTIONS["cut-in-b"]).controller,
            ),
            ("template", ConstantVelocity(), PerfectController()),
        ]
    ]
    for other in rollouts[1:]:
        np.testing.assert_array_equal(other.actor, rollouts[0].actor)
        np.testing.assert_array_equal(other.world_from_actor, rollouts[0].world_from_actor)
        np.testing.assert_array_equal(other.ego[0], rollouts[0].ego[0])
        np.testing.assert_array_equal(other.route, rollouts[0].route)
    assert len({rollout.name for rollout in rollouts}) == 3


def test_the_rollout_moves_with_the_world() -> None:
    moved = (120.0, -40.0, 2.0)
    setups = [
        RolloutSetup(drive(curvature=0.005, world_from_start=pose), "7", MOTIONS["cut-in-a"])
        for pose in ((0.0, 0.0, 0.0), moved)
    ]
    here, there = (run_rollout(setup, IdmLaneFollower()) for setup in setups)
    expected = se2.compose(moved, here.ego[:, :3])
    np.testing.assert_allclose(there.ego[:, :2], expected[:, :2], atol=1e-4)
    np.testing.assert_allclose(there.ego[:, 3:], here.ego[:, 3:], atol=1e-4)
    np.testing.assert_allclose(there.predictions, here.predictions, atol=1e-4)


def test_same_setup_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        setup = RolloutSetup(drive(curvature=0.004), "7", MOTIONS["cut-in-a"], steps=60)
        save_rollout(run_rollout(setup, IdmLaneFollower()), tmp_path / name)
    for file in sorted((tmp_path / "a").iterdir()):
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


def test_nothing_is_rendered_for_a_state_planner_without_film() -> None:
    renderer = CountingRenderer()
    setup = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], camera_names=("front",), steps=20)
    run_rollout(setup, LogReplay(), renderer)
    assert renderer.states == []


def test_an_image_planner_sees_its_cameras_at_plan_steps_only() -> None:
    renderer, planner, timings = CountingRenderer(), Recorder(needs_images=True), Timings()
    setup = RolloutSetup(
        drive(), "7", MOTIONS["cut-in-a"], camera_names=("front", "left"), steps=20
    )
    run_rollout(setup, planner, renderer, timings=timings)
    assert [state.step for state in renderer.states] == [0, 5, 10, 15]
    assert [o.images["left"].shape for o in planner.seen] == [(4, 6, 3)] * 4
    assert planner.context is not None
    assert planner.context.cameras["front"].camera.width == 8
    assert timings.frames == 8


def test_a_film_gets_every_step_once_in_order() -> None:
    renderer, planner = CountingRenderer(), Recorder(needs_images=True)
    frames: list[tuple[SimState, Mapping[str, NDArray[np.uint8]]]] = []
    setup = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], camera_names=("front",), steps=12)
    rollout = run_rollout(setup, planner, renderer, lambda state, im: frames.append((state, im)))
    assert [state.step for state, _ in frames] == list(range(12))
    assert sorted(state.step for state in renderer.states) == list(range(12))  # none twice
    for state, images in frames:
        assert images["front"].shape == (4, 8, 3)
        k = state.step
        np.testing.assert_array_equal(state.ego, rollout.ego[k])
        np.testing.assert_array_equal(state.world_from_rig, rollout.world_from_rig[k])
        np.testing.assert_array_equal(state.poses["7"], rollout.world_from_actor[k])
        assert state.timestamp_us == rollout.timestamp_us(k)


def test_images_without_a_renderer_are_refused() -> None:
    setup = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"])
    with pytest.raises(ValueError, match="planner recorder needs images"):
        run_rollout(setup, Recorder(needs_images=True))
    with pytest.raises(ValueError, match="on_frame needs images"):
        run_rollout(setup, LogReplay(), on_frame=lambda state, images: None)


def test_what_the_planner_sees() -> None:
    planner = Recorder()
    log = drive(seconds=25)
    setup = RolloutSetup(log, "7", MOTIONS["cut-in-a"], start_timestamp_us=5_000_000 + 1_000_000)
    rollout = run_rollout(setup, planner)
    first, later = planner.seen[0], planner.seen[6]
    assert (first.step, later.step) == (0, 30)
    assert later.timestamp_us == rollout.timestamp_us(30)
    # one second of log before the start, then the simulation, at most two seconds
    assert len(first.ego_history) == 11
    assert len(later.ego_history) == 21
    np.testing.assert_allclose(first.ego_history[0, 0], 0.0, atol=1e-6)
    np.testing.assert_array_equal(later.ego_history, rollout.ego[10:31])
    np.testing.assert_array_equal(later.ego, rollout.ego[30])
    (actor,) = later.actors
    assert (actor.track_id, actor.category) == ("7", "car")
    np.testing.assert_array_equal(actor.pose, rollout.actor[30, :3])
    assert np.linalg.norm(actor.velocity) == pytest.approx(rollout.actor[30, 3])
    assert later.command == "straight"


def test_other_actors_are_gone_unless_kept() -> None:
    planner, renderer = Recorder(needs_images=True), CountingRenderer()
    setup = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], camera_names=("front",), steps=10)
    assert run_rollout(setup, planner, renderer).other_actors == ()
    assert set(renderer.states[0].poses) == {"7"}

    kept = run_rollout(replace(setup, traffic="replay"), planner, renderer)
    assert kept.other_actors == ("9",)
    assert set(renderer.states[-1].poses) == {"7", "9"}
    other = planner.seen[-1].actors[1]
    assert other.track_id == "9"
    np.testing.assert_allclose(other.velocity, [5.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(other.pose, [2.5, -3.5, 0.0], atol=1e-5)


def test_log_and_simulation_lie_side_by_side() -> None:
    renderer = CountingRenderer()
    setup = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], camera_names=("front",), steps=10)
    run_rollout(setup, Recorder(needs_images=True), renderer)
    state = renderer.states[-1]
    np.testing.assert_allclose(state.log_ego, [5.0, 0.0, 0.0, 10.0], atol=1e-6)
    assert state.log_world_from_actor is not None
    np.testing.assert_allclose(state.log_world_from_actor[:3, 3], [5.0, 40.0, 0.0])


def test_a_wrong_plan_names_the_planner() -> None:
    class Short(Recorder):
        name = "short"

        def plan(self, observation: PlannerInput) -> Plan:
            return Plan(np.zeros((8, 3)))

    with pytest.raises(ValueError, match=r"planner short: .* expected \(40, 3\), got \(8, 3\)"):
        run_rollout(RolloutSetup(drive(), "7", MOTIONS["cut-in-a"]), Short())


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, "returned NoneType, not a Plan"),
        (np.zeros((40, 3)), "returned ndarray, not a Plan"),
        (Plan(np.full((40, 3), np.nan)), "NaN or infinity at waypoint 0"),
        (Plan([[0.0], [1.0, 2.0]]), "is not an array of numbers"),  # type: ignore[arg-type]
        (Plan(None), r"expected \(40, 3\), got \(\)"),  # type: ignore[arg-type]
    ],
)
def test_what_is_no_plan(answer: object, message: str) -> None:
    class Wrong(Recorder):
        name = "wrong"

        def plan(self, observation: PlannerInput) -> Plan:
            return answer  # type: ignore[return-value]

    with pytest.raises(ValueError, match=f"^planner wrong: .*{message}"):
        run_rollout(RolloutSetup(drive(), "7", MOTIONS["cut-in-a"]), Wrong())


def test_a_plan_that_takes_too_long_fails_the_rollout(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr("recast.simulation.planner_calls.perf_counter", lambda: clock[0])

    class Slow(Recorder):
        name = "slow"

        def plan(self, observation: PlannerInput) -> Plan:
            clock[0] += 2.5 if observation.step == 10 else 0.4
            return super().plan(observation)

    setup = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], steps=20)
    run_rollout(setup, Slow())
    with pytest.raises(
        ValueError, match=r"^planner slow: took 2.5 s .* step 10, but the limit is 0.5 s"
    ):
        calls, simulator = PlannerCalls(Slow()), Simulator(setup)
        calls.reset(simulator.context)
        while not simulator.done:
            simulator.step(calls.timed_plan(simulator.observe(), 0.5)[0])


class Looker(Recorder):
    """Looks at one camera only."""

    camera_names = ("left",)

    def __init__(self) -> None:
        super().__init__(needs_images=True)


def test_a_planner_that_names_its_cameras_gets_only_those() -> None:
    renderer, planner, timings = CountingRenderer(), Looker(), Timings()
    setup = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], steps=12, camera_names=("front",))
    run_rollout(setup, planner, renderer, timings=timings)
    assert [set(seen.images) for seen in planner.seen] == [{"left"}] * 3
    assert planner.context is not None and set(planner.context.cameras) == {"left"}
    assert timings.frames == 3

    frames: list[Mapping[str, NDArray[np.uint8]]] = []
    run_rollout(setup, planner, renderer, lambda state, images: frames.append(images), timings)
    assert [set(images) for images in frames] == [{"front"}] * 12
    assert [set(seen.images) for seen in planner.seen] == [{"left"}] * 3
    assert timings.frames == 3 + 12 + 3


def test_a_camera_that_cannot_be_rendered_is_named() -> None:
    class Backward(Looker):
        camera_names = ("front", "rear")

    setup = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"])
    with pytest.raises(InputError, match=r"recorder: camera rear: is needed .* front, left"):
        run_rollout(setup, Backward(), CountingRenderer())


def test_a_standing_planner_may_stand() -> None:
    class Stop(Recorder):
        def plan(self, observation: PlannerInput) -> Plan:
            return Plan(np.zeros((40, 3)))

    rollout = run_rollout(RolloutSetup(drive(), "7", MOTIONS["cut-in-a"]), Stop())
    assert rollout.steps_run == 160
    assert abs(rollout.ego[-1, 3]) < 0.2


def test_prepare_and_run_agree() -> None:
    setup = RolloutSetup(drive(), "7", MOTIONS["oncoming-a"], steps=30)
    prepared, rollout = prepare(setup), run_rollout(setup, LogReplay())
    np.testing.assert_array_equal(prepared.actor, rollout.actor)
    np.testing.assert_array_equal(prepared.ego, rollout.ego[0])


def test_a_start_beside_the_logged_one_moves_the_ego_and_its_past_alone() -> None:
    setup = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], steps=10, start_timestamp_us=8_000_000)
    recorder, beside = Recorder(), Recorder()
    logged = run_rollout(setup, recorder)
    moved = run_rollout(replace(setup, start_left=0.05), beside)
    for one, other in zip(recorder.seen[0].ego_history, beside.seen[0].ego_history, strict=True):
        step = se2.relative(one[:3], other[:3])
        np.testing.assert_allclose(step, [0, 0.05, 0], atol=1e-12)
        np.testing.assert_array_equal(one[3:], other[3:])
    np.testing.assert_array_equal(moved.ego[0], beside.seen[0].ego_history[-1])
    for name in ("actor", "world_from_actor", "log_ego", "route"):
        np.testing.assert_array_equal(getattr(logged, name), getattr(moved, name))


def test_a_start_that_is_nowhere_is_refused() -> None:
    with pytest.raises(InputError, match="start_left"):
        RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], start_left=float("nan"))


class Looking(Recorder):
    """Looks at the middle of the front camera, and plans by what it sees."""

    def __init__(self) -> None:
        super().__init__(needs_images=True)
        self.wanted_views = (View("front", MOUNTS["front"].camera, 0.0, 1, 2),)

    def choose_cameras(self, mounts: Mapping[str, CameraMount]) -> dict[str, str]:
        return {"front": "front"}

    def plan(self, observation: PlannerInput) -> Plan:
        plan = super().plan(observation)
        return Plan(plan.waypoints * (1 + observation.images["front"].sum() / 1e5))


class Stepwise(NullRenderer):
    """Other pixels in each step, over the whole image."""

    def render(self, state: SimState, camera_names: object) -> dict[str, NDArray[np.uint8]]:
        images = super().render(state, camera_names)
        return {name: image + np.uint8(state.step % 7 + 1) for name, image in images.items()}


def test_a_film_changes_neither_what_is_seen_nor_what_is_driven() -> None:
    setup = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], steps=20, camera_names=tuple(MOUNTS))
    frames: list[int] = []
    rollouts, seen = [], []
    for film in (None, lambda state, images: frames.append(len(images))):
        planner = Looking()
        rollouts.append(run_rollout(setup, planner, Stepwise(MOUNTS), film))
        seen.append(np.array([one.images["front"] for one in planner.seen]))
        assert planner.context is not None
        assert planner.context.cameras["front"].window == (2, 1, 6, 3)
    assert frames == [2] * 20
    np.testing.assert_array_equal(*seen)
    assert not seen[0][:, 0].any() and seen[0][:, 1, 2].all()
    np.testing.assert_array_equal(rollouts[0].ego, rollouts[1].ego)


def test_the_replay_of_a_log_is_the_log() -> None:
    setup = RolloutSetup(drive(12.0, curvature=0.01), "7", MOTIONS["advancing-a"], steps=60)
    rollout = run_rollout(setup, LogReplay())
    times = rollout.start_timestamp_us + 100_000 * np.arange(61)
    logged = se2.from_se3(setup.log.world_from_rig.at(times))
    np.testing.assert_allclose(rollout.ego[:, :3], logged, atol=1e-9)
    np.testing.assert_allclose(rollout.ego[:, 3], 12.0, atol=0.01)


class Elsewhere(ConstantVelocity):
    """Plans in the world's frame, or at another time step."""

    def __init__(self, shift: float, stretch: float) -> None:
        super().__init__()
        self.shift, self.stretch = shift, stretch

    def plan(self, observation: PlannerInput) -> Plan:
        return Plan(super().plan(observation).waypoints * self.stretch + [self.shift, 0.0, 0.0])


@pytest.mark.parametrize(("shift", "stretch", "told"), [(0, 1, 0), (500, 1, 1), (0, 5, 1)])
def test_a_plan_out_of_reach_is_told_once(shift: float, stretch: float, told: int) -> None:
    setup = RolloutSetup(
        drive(), "7", MOTIONS["cut-in-a"], steps=10, controller=HeldStraight()
    )  # fmt: skip
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run_rollout(setup, Elsewhere(shift, stretch))
    assert [str(w.message).startswith("planner constant-velocity: the first") for w in caught] == (
        [True] * told
    )


class HeldStraight(PerfectController):
    """Drives straight on, whatever the plan says."""

    def execute(self, state, waypoints, steps, vehicle, dt):  # type: ignore[no-untyped-def]
        ahead = np.zeros((40, 3))
        ahead[:, 0] = state[3] * dt * np.arange(1, 41)
        return super().execute(state, ahead, steps, vehicle, dt)
