"""A simulation can be branched at any step, and replayed, with what its parts remember."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recast.arrays import Array, Image
from recast.cameras import CameraMount, PinholeCamera
from recast.core.errors import InputError
from recast.planning import BasePlanner, Plan, Planner, PlannerInput, PlanningContext
from recast.simulation import (
    MOTIONS,
    BaseController,
    BaseMotion,
    MotionInput,
    MountedRenderer,
    PerfectController,
    Rollout,
    RolloutSetup,
    SimState,
    Simulator,
    StartSituation,
    load_rollout,
    run_rollout,
    save_rollout,
)
from recast.simulation.planner_calls import PlannerCalls, PlannerProcess
from recast.simulation.renderer import RestoringRenderer
from support.synthetic_drives import drive

MOUNTS = {
    name: CameraMount(PinholeCamera(8, 4, 5.0, 5.0, 4.0, 2.0), np.eye(4))
    for name in ("front", "left")
}


class Noise(MountedRenderer):
    """Other images at each step."""

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        rngs = {name: np.random.default_rng([state.step, len(name)]) for name in camera_names}
        return {name: rng.integers(0, 256, (4, 8, 3), np.uint8) for name, rng in rngs.items()}


class Draws(BasePlanner):
    """A sampling planner: each plan is drawn, from numbers of its own and from numpy's."""

    name = "draws"

    def reset(self, context: PlanningContext) -> None:
        self._rng = np.random.default_rng(context.seed)

    def plan(self, observation: PlannerInput) -> Plan:
        speed = observation.ego.vx + self._rng.uniform(-2.0, 2.0) + np.random.uniform(-0.5, 0.5)  # noqa: NPY002
        waypoints = np.zeros((40, 3))
        waypoints[:, 0] = max(speed, 0.0) * 0.1 * np.arange(1, 41)
        return Plan(waypoints)


class Strays(BaseMotion):
    """A motion that reacts, remembers its way, and draws from numpy's numbers."""

    name, setting = "strays", "a"

    def start(self, situation: StartSituation) -> Array:
        self.way: list[Array] = [np.array([45.0, 3.5, 0.0, 8.0])]
        return self.way[0]

    def step(self, state: MotionInput, dt: float) -> Array:
        new = self.way[-1].copy()
        new[3] = max(new[3] + np.random.uniform(-0.5, 0.5), 0.0)  # noqa: NPY002
        new[0] += new[3] * dt
        self.way.append(new)
        return new


class Wears(BaseController):
    """A controller that follows plans ever less, until it is reset."""

    def reset(self, context: PlanningContext) -> None:
        self.worn = 1.0

    def execute(self, state: Array, waypoints: Array, steps: int, vehicle: Any, dt: float) -> Array:
        self.worn *= 0.98
        return PerfectController().execute(state, waypoints * self.worn, steps, vehicle, dt)


class Fades:
    """A restorer that mixes each image with the one before."""

    name = "fades"

    def __init__(self) -> None:
        self.before: dict[str, Image] = {}

    def restore(self, images: Mapping[str, Image]) -> Mapping[str, Image]:
        mixed = {k: np.uint8(v // 2 + self.before.get(k, v) // 2) for k, v in images.items()}
        self.before = mixed
        return mixed


@dataclass(frozen=True)
class Case:
    """A setup whose parts remember something, or do not."""

    setup: RolloutSetup

    def simulator(self, **options: Any) -> Simulator:
        return Simulator(self.setup, Noise(MOUNTS), **options)


CASES = {
    "scripted": Case(RolloutSetup(drive(), "7", MOTIONS["cut-in-a"], steps=40)),
    "reactive": Case(
        RolloutSetup(
            drive(),
            "7",
            Strays(),
            actors={"9": MOTIONS["idm-a"]},
            controller=Wears(),
            steps=40,
            seed=5,
        )
    ),
}


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


def calls_of(planner: Planner, sim: Simulator) -> PlannerCalls:
    calls = PlannerCalls(planner)
    calls.reset(sim.context)
    return calls


def go_on(sim: Simulator, calls: PlannerCalls, cycles: int = 1_000) -> list[Plan]:
    plans: list[Plan] = []
    while not sim.done and len(plans) < cycles:
        plans.append(calls.timed_plan(sim.observe(), None)[0])
        sim.advance(plans[-1])
    return plans


def assert_same(first: Rollout, second: Rollout) -> None:
    for one in fields(Rollout):
        a, b = getattr(first, one.name), getattr(second, one.name)
        if isinstance(a, np.ndarray):
            assert a.tobytes() == b.tobytes(), one.name
        elif one.name == "controlled":
            assert [c.states.tobytes() for c in a] == [c.states.tobytes() for c in b]
        elif one.name != "origin":
            assert a == b, one.name


def test_a_branch_goes_on_as_its_origin_would(case: Case) -> None:
    sim = case.simulator(planner="draws")
    calls = calls_of(Draws(), sim)
    go_on(sim, calls, 3)
    branch, its_calls = sim.copy(), deepcopy(calls)
    go_on(branch, its_calls)
    assert branch.step_number == 40 and sim.step_number == 15
    go_on(sim, calls)
    assert_same(branch.rollout, sim.rollout)
    assert_same(sim.rollout, run_rollout(case.setup, Draws()))


def test_a_branch_leaves_its_origin_alone(case: Case) -> None:
    sim = case.simulator()
    calls = calls_of(Draws(), sim)
    go_on(sim, calls, 3)
    before, seen = sim.rollout, sim.observe({})
    for speed in (0.0, 3.0):
        branch = sim.copy()
        waypoints = np.zeros((40, 3))
        waypoints[:, 0] = speed * 0.1 * np.arange(1, 41)
        while not branch.done:
            branch.step(Plan(waypoints))
        branch.reset(9)
        branch.step(Plan(waypoints))
    assert_same(sim.rollout, before)
    assert sim.step_number == 15 and not sim.done
    again = sim.observe({})
    assert again.ego_history.tobytes() == seen.ego_history.tobytes()
    assert [a.pose.tobytes() for a in again.actors] == [a.pose.tobytes() for a in seen.actors]
    go_on(sim, calls)
    assert_same(sim.rollout, replace(run_rollout(case.setup, Draws()), planner="external"))


def test_branches_of_the_same_plans_are_the_same(case: Case) -> None:
    sim = case.simulator()
    go_on(sim, calls_of(Draws(), sim), 2)
    first, second = sim.copy(), sim.copy().copy()
    plans = go_on(first, calls_of(Draws(), sim))
    for plan in plans:
        second.advance(plan)
    assert_same(first.rollout, second.rollout)


def test_a_branch_shares_the_log_and_hands_out_read_only_data() -> None:
    sim = CASES["reactive"].simulator()
    branch = sim.copy()
    assert branch.setup.log is sim.setup.log and branch.context is sim.context
    assert branch.setup.motion is not sim.setup.motion
    with pytest.raises(ValueError, match="read-only"):
        branch.observe({}).ego_history[0, 0] = 1.0


def test_a_branch_has_a_restorer_of_its_own() -> None:
    setup = CASES["scripted"].setup
    restorer = Fades()
    sim = Simulator(setup, RestoringRenderer(Noise(MOUNTS), restorer))
    go_on(sim, calls_of(Draws(), sim), 2)
    kept = {name: image.copy() for name, image in restorer.before.items()}
    branch = sim.copy()
    go_on(branch, calls_of(Draws(), branch))
    assert all(np.array_equal(restorer.before[name], kept[name]) for name in kept)
    go_on(sim, calls_of(Draws(), sim), 1)
    assert any(not np.array_equal(restorer.before[name], kept[name]) for name in kept)


def films_of(setup: RolloutSetup) -> tuple[Rollout, list[tuple[int, dict[str, bytes]]]]:
    film: list[tuple[int, dict[str, bytes]]] = []

    def on_frame(state: SimState, images: Mapping[str, Image]) -> None:
        film.append((state.step, {name: image.tobytes() for name, image in images.items()}))

    return run_rollout(setup, Draws(), Noise(MOUNTS), on_frame), film


@pytest.mark.parametrize("filmed", [False, True])
def test_a_replay_is_exact(case: Case, filmed: bool, tmp_path: Path) -> None:
    setup = replace(case.setup, camera_names=tuple(MOUNTS))
    rollout, film = films_of(setup)
    save_rollout(rollout, tmp_path / "rollout")
    stored = load_rollout(tmp_path / "rollout")
    again: list[tuple[int, dict[str, bytes]]] = []

    def on_frame(state: SimState, images: Mapping[str, Image]) -> None:
        again.append((state.step, {name: image.tobytes() for name, image in images.items()}))

    sim = Simulator(setup, Noise(MOUNTS))
    go_on(sim, calls_of(Draws(), sim), 2)
    for given in (rollout, stored):
        again.clear()
        assert_same(sim.replay(given, on_frame if filmed else None), rollout)
        assert sim.done and again == (film if filmed else [])


def test_plans_are_replayed_and_gone_on_from(case: Case) -> None:
    sim = case.simulator(planner="draws")
    plans = go_on(sim, calls_of(Draws(), sim))
    whole = sim.rollout
    part = sim.replay(plans[:4])
    assert part.steps_run == 20 and not sim.done
    assert part.ego.tobytes() == whole.ego[:21].tobytes()
    for plan in plans[4:]:
        sim.advance(plan)
    assert_same(sim.rollout, whole)


def test_a_rollout_of_another_setup_or_seed_is_refused() -> None:
    rollout = run_rollout(CASES["reactive"].setup, Draws())
    other = replace(CASES["reactive"].setup, controller=PerfectController())
    with pytest.raises(InputError, match="does not come from these plans in this simulator"):
        Simulator(other).replay(rollout)


def test_a_rollout_whose_last_plan_led_off_the_road_is_replayed() -> None:
    setup = RolloutSetup(drive(seconds=20, speed=5.0), "7", MOTIONS["stationary-b"], steps=160)

    class Races(BasePlanner):
        name = "races"

        def plan(self, observation: PlannerInput) -> Plan:
            waypoints = np.zeros((40, 3))
            waypoints[:, 0] = 2.0 * np.arange(1, 41)
            return Plan(waypoints)

    setups: Sequence[RolloutSetup] = [replace(setup, road_margin=0.3 * k) for k in range(10)]
    cut = set()
    for one in setups:
        rollout = run_rollout(replace(one, controller=PerfectController()), Races())
        replayed = Simulator(replace(one, controller=PerfectController())).replay(rollout)
        assert_same(replayed, rollout)
        cut.add(rollout.steps_run % 5)
    assert 0 in cut and len(cut) > 1


def test_a_planner_in_a_process_of_its_own_cannot_be_branched() -> None:
    with pytest.raises(InputError, match="planner draws: copy: runs in a process of its own"):
        deepcopy(PlannerProcess(Draws()))
