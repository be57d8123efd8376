from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from recast.cameras import CameraMount, PinholeCamera
from recast.core.errors import InputError
from recast.dynamics import EgoState
from recast.geometry import se2
from recast.logs.types import DrivingLog
from recast.planning import (
    ConstantVelocity,
    IdmLaneFollower,
    Plan,
    Planner,
    PlannerInput,
    PlanningContext,
)
from recast.scene.street_scene import StreetScene
from recast.simulation import (
    MOTIONS,
    Ending,
    LqrController,
    NullRenderer,
    RolloutSettings,
    RolloutSetup,
    Simulator,
    StartSituation,
    make_setup,
    motion,
    prepare,
    run_rollout,
    save_rollout,
)
from support.camera_drives import log_with_camera
from support.synthetic_drives import drive

MOUNTS = {"front": CameraMount(PinholeCamera(8, 4, 5.0, 5.0, 4.0, 2.0), np.eye(4))}


def simulator(log: DrivingLog | None = None, name: str = "cut-in-a", **settings) -> Simulator:
    made = RolloutSettings(**{"steps": 20, **settings})
    return Simulator(log or drive(), actors={"7": name}, settings=made)


def straight(speed: float = 8.0) -> Plan:
    waypoints = np.zeros((40, 3))
    waypoints[:, 0] = speed * 0.1 * np.arange(1, 41)
    return Plan(waypoints)


def drive_through(sim: Simulator, planner: Planner) -> None:
    planner.reset(sim.context)
    observation = sim.reset()
    while not sim.done:
        observation = sim.step(planner.plan(observation))


def reference_loop(setup: RolloutSetup, planner: Planner) -> tuple[NDArray, list[NDArray]]:
    """The loop without a simulator: ego states and plans, for a scripted actor and no cuts."""
    prepared = prepare(setup)
    step_us = round(setup.dt * 1e6)
    planner.reset(
        PlanningContext(
            prepared.route, setup.log.world_from_rig, vehicle=setup.vehicle, dt=setup.dt
        )
    )
    sim = Simulator(setup)
    states, plans = [prepared.ego], []
    while len(states) <= prepared.steps:
        step = len(states) - 1
        if step:
            sim.advance(plans[-1])
        seen = PlannerInput(
            step=step,
            timestamp_us=prepared.start_timestamp_us + step * step_us,
            ego=states[-1],
            ego_history=np.array(states[-21:]),
            actors=sim.observe().actors,
            command=prepared.route.command(states[-1]),
        )
        plans.append(planner.plan(seen))
        steps = min(setup.plan_every, prepared.steps - step)
        driven = LqrController().execute(
            states[-1], plans[-1].waypoints, steps, setup.vehicle, setup.dt
        )
        states.extend(driven[1:])
    return np.array(states), [plan.waypoints for plan in plans]


@pytest.mark.parametrize("name", ["cut-in-a", "stationary-b", "advancing-a"])
def test_the_simulator_the_loop_and_a_plain_loop_agree(name: str) -> None:
    setup = RolloutSetup(drive(curvature=0.004), "7", MOTIONS[name], steps=43)
    states, plans = reference_loop(setup, IdmLaneFollower())
    sim = Simulator(setup)
    drive_through(sim, IdmLaneFollower())
    for rollout in (sim.rollout, run_rollout(setup, IdmLaneFollower())):
        assert rollout.ego.tobytes() == states.tobytes()
        assert rollout.predictions.tobytes() == np.array(plans).tobytes()
        assert rollout.actor.tobytes() == prepare(setup).actor.tobytes()
        assert rollout.plan_steps.tolist() == list(range(0, 43, 5))


def test_the_loop_of_the_page(scene: StreetScene) -> None:
    sim = Simulator(
        log_with_camera(),
        scene,
        actors={"7": motion("stationary")},
        settings=RolloutSettings(steps=10),
    )
    planner = ConstantVelocity()
    planner.reset(sim.context)
    observation = sim.reset()
    assert observation.images["front"].shape == (48, 64, 3)
    while not sim.done:
        observation = sim.step(planner.plan(observation))
    assert observation.step == sim.rollout.steps_run == 10
    assert sim.rollout.planner == "external"
    small = Simulator(
        log_with_camera(), scene, {"7": "stationary"}, scale=0.5, settings=RolloutSettings(steps=10)
    )
    assert small.reset().images["front"].shape == (24, 32, 3)


def test_a_motion_may_be_a_name_or_an_object() -> None:
    by_name, by_object = simulator(), simulator(name=MOTIONS["cut-in-a"])  # type: ignore[arg-type]
    drive_through(by_name, ConstantVelocity())
    drive_through(by_object, ConstantVelocity())
    assert by_name.rollout.actor.tobytes() == by_object.rollout.actor.tobytes()
    assert by_name.rollout.name == "cut-in-a-scene"


def test_the_state_has_names_and_the_log_beside_it() -> None:
    sim = simulator()
    sim.step(straight(6.0))
    state = sim.state
    assert isinstance(state.ego, EgoState) and state.step == 5
    assert state.ego.speed == state.ego[3] < 10.0
    np.testing.assert_allclose(state.log_ego, [5.0, 0.0, 0.0, 10.0], atol=1e-6)
    assert list(state.actors) == ["7"] == [state.track_id]
    assert state.actors["7"].log_world_from_actor[1, 3] == 40.0
    assert sim.state_at(0).ego.x == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(ValueError, match="state_at: expected step 0 to 5, got 6"):
        sim.state_at(6)


def test_an_observation_is_read_only() -> None:
    sim = simulator()
    observation = sim.reset()
    with pytest.raises(ValueError, match="read-only"):
        observation.ego[0] += 100.0
    with pytest.raises(ValueError, match="read-only"):
        observation.ego_history[:] = 0.0
    assert sim.state.ego.x == pytest.approx(0.0, abs=1e-9)


def test_only_who_foresees_is_told_what_comes() -> None:
    """As it comes: of a script and of the log to the end, of an actor that reacts not."""
    sim = simulator(traffic="replay")
    sim.step(straight(6.0))
    target, other = sim.observe(foretold=True).actors
    assert target.future is not None and other.future is not None
    now, path = sim.state.timestamp_us, drive().tracks["9"].trajectory
    times = now + 100_000 * np.arange(len(other.future))
    np.testing.assert_allclose(other.future, se2.from_se3(path.at(times)), atol=1e-9)
    assert all(one.future is None for one in sim.observe().actors)
    while not sim.done:
        sim.step(straight(6.0))
    np.testing.assert_array_equal(target.future, sim.rollout.actor[5:, :3])
    reacting = simulator(name="idm-a").observe(foretold=True).actors
    assert [one.future for one in reacting] == [None]


class Sees(ConstantVelocity):
    """Notes whether it is told what comes."""

    name = "sees"

    def __init__(self, foresees: bool) -> None:
        super().__init__()
        self.foresees, self.told = foresees, set[bool]()

    def plan(self, observation: PlannerInput) -> Plan:
        self.told.add(observation.actors[0].future is not None)
        return super().plan(observation)


@pytest.mark.parametrize("foresees", [False, True])
def test_a_rollout_tells_a_planner_what_it_asks_for(foresees: bool) -> None:
    planner = Sees(foresees)
    run_rollout(make_setup(drive(), RolloutSettings(steps=20), {"7": "cut-in-a"}), planner)
    assert planner.told == {foresees}


def test_reset_begins_anew_with_the_same_bytes(tmp_path: Path) -> None:
    sim = simulator(traffic="replay")
    for name in ("a", "b"):
        drive_through(sim, IdmLaneFollower())
        save_rollout(sim.rollout, tmp_path / name)
    for file in sorted((tmp_path / "a").iterdir()):
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()


class Drawn:
    """A user's scripted motion with a random gap."""

    name, setting = "drawn", "a"

    def script(self, start: StartSituation, steps: int, dt: float) -> NDArray[np.float64]:
        gap = np.random.default_rng(start.seed).uniform(10.0, 40.0)
        pose = start.route.pose(start.ahead(gap))
        return np.tile(np.append(pose, 0.0), (steps + 1, 1))


def test_a_motion_may_draw_from_the_seed() -> None:
    sim = simulator(name=Drawn())  # type: ignore[arg-type]
    places = []
    for seed in (None, 0, 3, 3):
        sim.reset(seed)
        places.append(sim.state.actor[0])
    assert places[0] == places[1] != places[2] == places[3]


def test_before_the_first_step_there_is_no_rollout() -> None:
    sim = simulator()
    with pytest.raises(ValueError, match="no step was executed; call step"):
        _ = sim.rollout
    sim.step(straight())
    stopped = sim.rollout
    assert (stopped.steps_run, stopped.cut_reason) == (5, "stopped before its end")
    sim.reset()
    with pytest.raises(ValueError, match="no step was executed"):
        _ = sim.rollout


def test_after_the_end_a_step_is_refused() -> None:
    sim = simulator(steps=10)
    sim.step(straight())
    assert (sim.done, sim.ending) == (False, None)
    sim.step(straight())
    assert (sim.done, sim.ending) == (True, Ending.STEPS)
    with pytest.raises(ValueError, match=r"^Simulator.step: the rollout is over; call reset$"):
        sim.step(straight())


def test_endings_say_who_came_to_the_end_of_what() -> None:
    short = simulator(drive(seconds=6), steps=160, name="stationary-a")
    while not short.done:
        short.step(straight(5.0))
    assert (short.ending, short.cut_reason) == (Ending.LOG, "the log ends 6.0 s after the start")
    fast = simulator(drive(seconds=20, speed=5.0), steps=160, name="stationary-b")
    while not fast.done:
        fast.step(straight(20.0))
    assert fast.ending is Ending.EGO
    assert "the ego would leave the recorded road" in str(fast.cut_reason)
    behind = simulator(drive(seconds=20, speed=5.0), steps=160, name="stationary-b")
    while not behind.done:
        behind.step(straight(-5.0))
    assert behind.ending is Ending.EGO_BEFORE


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (None, "got NoneType, not a Plan"),
        (np.zeros((40, 3)), "got ndarray, not a Plan"),
        (Plan(np.zeros((8, 3))), r"expected \(40, 3\), got \(8, 3\)"),
        (Plan(np.full((40, 3), np.nan)), "NaN or infinity at waypoint 0"),
        (Plan("no"), "is not an array of numbers"),  # type: ignore[arg-type]
    ],
)
def test_what_is_no_plan_moves_nothing(plan: object, message: str) -> None:
    sim = simulator()
    with pytest.raises(ValueError, match=f"^Simulator.step: .*{message}") as error:
        sim.step(plan)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)
    assert sim.step_number == 0 and not sim.done


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_plan_that_no_vehicle_can_drive_is_one_line() -> None:
    sim = simulator()
    with pytest.raises(InputError, match="plan at step 0: leads to ego states that are not finite"):
        sim.step(Plan(np.full((40, 3), 1e200)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"actors": {}}, "Simulator: actors: is empty or not a mapping; name the target"),
        ({"actors": {"7": "cutin"}}, "motion: cutin: is not known; choose one of"),
        ({"actors": {"7": 3}}, "motion: int: is not a motion: a motion has name, setting"),
        ({"actors": {"77": "cut-in"}}, "track 77: is not in the log; choose one of 7, 9"),
        ({"actors": {"7": "cut-in", "8": "idm"}}, "track 8: is not in the log"),
        ({"scene": 3}, "Simulator: scene: is a int; give a StreetScene"),
        ({"cameras": ["front"]}, "Simulator: cameras: are given without a scene"),
        ({"settings": 3}, "Simulator: settings: is 3; give a RolloutSettings or None"),
        ({"steps": 3}, "Simulator: steps: is not an argument"),
        ({"log": RolloutSetup(drive(), "7", MOTIONS["cut-in-a"])}, "actors: are given beside a"),
        ({"scene": NullRenderer(MOUNTS), "cameras": ["rear"]}, "camera rear: is needed but"),
    ],
)
def test_bad_arguments_are_one_line(arguments: dict[str, object], message: str) -> None:
    given = {"log": drive(), "actors": {"7": "cut-in-a"}, **arguments}
    with pytest.raises(InputError, match=message) as error:
        Simulator(**given)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"steps": 0}, "RolloutSettings: steps: is 0; give 1 to"),
        ({"steps": "9"}, "RolloutSettings: steps: is '9'; give an integer"),
        ({"dt": 3.0}, "RolloutSettings: dt: is 3.0 s"),
        ({"road_margin": -1}, "RolloutSettings: road_margin: is -1.0 m"),
        ({"controller": object()}, "builtins.object: execute: is missing"),
        ({"map": drive()}, "RolloutSettings: map: is an object of type DrivingLog; give a HdMap"),
    ],
)
def test_bad_settings_are_one_line(settings: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        RolloutSettings(**settings)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)


def test_a_setup_and_a_log_with_settings_are_the_same() -> None:
    settings = RolloutSettings(steps=30, dt=0.05, seed=4, camera_names=("front",))
    made = make_setup(log := drive(), settings, {"7": "cut-in", "9": "idm"})
    assert made == RolloutSetup(
        log,
        "7",
        MOTIONS["cut-in-a"],
        actors={"9": MOTIONS["idm-a"]},
        steps=30,
        dt=0.05,
        seed=4,
        camera_names=("front",),
    )
    sim = Simulator(log, NullRenderer(MOUNTS), {"7": "cut-in"}, settings)
    assert set(sim.context.cameras) == {"front"} and sim.context.seed == 4


def test_a_scale_that_is_no_size(scene: StreetScene) -> None:
    with pytest.raises(InputError, match=r"Simulator: scale: is 0\.0"):
        Simulator(log_with_camera(), scene, {"7": "cut-in"}, scale=0.0)


def test_a_renderer_may_be_given_and_only_named_cameras_are_rendered() -> None:
    mounts = {**MOUNTS, "left": MOUNTS["front"]}
    both = Simulator(
        drive(), NullRenderer(mounts), {"7": "cut-in"}, settings=RolloutSettings(steps=10)
    )
    assert set(both.reset().images) == set(both.context.cameras) == {"front", "left"}
    one = Simulator(
        drive(),
        NullRenderer(mounts),
        {"7": "cut-in"},
        cameras=["left"],
        settings=RolloutSettings(steps=10),
    )
    assert set(one.reset().images) == {"left"}
    with pytest.raises(ValueError, match="give the simulator a scene"):
        simulator().render(["front"])


def test_a_rollout_of_this_process_knows_what_it_was_run_with(tmp_path: Path) -> None:
    setup, renderer = RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], steps=10), NullRenderer({})
    rollout = run_rollout(setup, ConstantVelocity(), renderer)
    assert rollout.origin is not None
    assert rollout.origin.setup is setup and rollout.origin.renderer is renderer
    assert "origin" not in repr(rollout)
    assert rollout.first(5).origin is rollout.origin
    assert pickle.loads(pickle.dumps(rollout)).origin is None


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_a_limit_is_positive(limit: float) -> None:
    with pytest.raises(InputError, match="plan_limit_s: is "):
        RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], plan_limit_s=limit)


def test_the_package_is_imported_without_torch() -> None:
    code = "import sys; sys.modules['torch'] = None; import recast.simulation"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
