"""What users' planners, motions, controllers and renderers share with the simulation: nothing."""

from __future__ import annotations

import copy
import os
import pickle
import random
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from recast.cameras import CameraMount, PinholeCamera
from recast.core.errors import InputError
from recast.dynamics import VehicleParameters
from recast.logs import map_of
from recast.planning import ConstantVelocity, Plan, PlannerInput
from recast.simulation import (
    MOTIONS,
    MotionInput,
    PerfectController,
    Rollout,
    RolloutSetup,
    SimState,
    Simulator,
    StartSituation,
    error_fields,
    run_rollout,
)
from recast.simulation.planner_calls import PlannerProcess
from support.rude_planners import Does, Drawn, Moods, OneArray, spoil
from support.synthetic_drives import drive

LOG = drive(seconds=8)
SETUP = RolloutSetup(LOG, "7", MOTIONS["cut-in-a"], steps=20, map=map_of(LOG))


def assert_same(first: Rollout, second: Rollout) -> None:
    for name in ("ego", "actor", "predictions"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


def test_plans_of_one_array_are_recorded_as_they_were() -> None:
    rollout = run_rollout(SETUP, OneArray())
    assert rollout.predictions[:, 0, 0] == pytest.approx([0.5, 0.55, 0.6, 0.65])
    sim, planner = Simulator(SETUP), OneArray()
    sim.reset()
    while not sim.done:
        sim.step(planner.plan(sim.observe()))
    assert_same(sim.rollout, rollout)


@pytest.mark.parametrize(
    "deed",
    [
        lambda _, seen, context: seen.actors[0].size.__iadd__(1.0),
        lambda _, seen, context: seen.ego.__setitem__(0, 3.0),
        lambda _, seen, context: seen.images.clear(),
        lambda _, seen, context: seen.ego_history.sort(),
        lambda _, seen, context: context.log.poses.fill(0.0),
        lambda _, seen, context: context.log.timestamps_us.__iadd__(1),
        lambda _, seen, context: context.route.line.points.fill(0.0),
        lambda _, seen, context: context.route.speeds.fill(0.0),
        lambda _, seen, context: context.cameras.update(a=1),
        lambda _, seen, context: context.map.lanes.clear(),
        lambda _, seen, context: next(iter(context.map.lanes.values())).polygon.fill(0.0),
        lambda _, seen, context: context.map.drivable_area[0].fill(0.0),
        lambda _, seen, context: context.map.notes.update(a="b"),
    ],
)
def test_who_writes_is_told_to_copy(deed: Callable[..., object]) -> None:
    with pytest.raises(InputError) as raised:
        run_rollout(SETUP, Does(deed))
    line = error_fields(raised.value)["reason"]
    assert line.startswith("planner does: plan at step 5: writes into a read-only object (")
    assert "copy what recast hands over before you change it" in line


def test_copies_of_what_is_given_may_be_changed() -> None:
    def deed(planner: Any, seen: PlannerInput, context: Any) -> None:
        for made in (copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))):
            own, own_context = made(seen), made(context)
            own.actors[0].size[0] = own.ego[0] = 0.0
            own.images["mine"] = own_context.log.poses
            own_context.map.lanes.clear()
        planner.kept = copy.deepcopy(planner.context)

    assert_same(run_rollout(SETUP, Does(deed)), run_rollout(SETUP, ConstantVelocity()))


@pytest.mark.parametrize("error", [SystemExit(0), SystemExit("bye"), GeneratorExit()])
def test_who_ends_the_program_is_a_failed_rollout(error: BaseException) -> None:
    def deed(*_: object) -> None:
        raise error

    message = "planner does: plan at step 5: ends the program .*raise an exception that says"
    with pytest.raises(InputError, match=message):
        run_rollout(SETUP, Does(deed))


def test_an_interrupt_remains_one() -> None:
    def deed(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_rollout(SETUP, Does(deed))


def test_what_a_planner_does_to_the_process_is_put_back() -> None:
    def state() -> list[Any]:
        return [
            Path.cwd(),
            torch.get_num_threads(),
            torch.get_default_dtype(),
            torch.is_grad_enabled(),
            np.geterr(),
            list(warnings.filters),
            signal.getsignal(signal.SIGINT),
            sys.stdout,
            sys.stderr,
            random.getstate(),
            np.random.get_state()[1].tolist(),  # type: ignore[index]  # noqa: NPY002
            torch.get_rng_state().tolist(),
        ]

    before = state()
    run_rollout(SETUP, Does(spoil))
    assert state() == before
    assert not sys.stdout.closed


def test_random_numbers_are_of_the_rollout() -> None:
    planner = Drawn()
    first = run_rollout(SETUP, planner)
    for other in (planner, copy.deepcopy(planner), Drawn()):
        random.seed(), np.random.seed(), torch.seed()  # noqa: NPY002
        assert_same(run_rollout(SETUP, other), first)
    assert run_rollout(replace(SETUP, seed=4), planner).ego.tobytes() != first.ego.tobytes()


def test_the_seed_of_a_simulator_reaches_the_planner() -> None:
    sim = Simulator(replace(SETUP, seed=3))
    assert sim.context.seed == 3
    sim.reset(5)
    assert sim.context.seed == 5
    sim.reset()
    assert sim.context.seed == 3


def test_a_planner_with_a_limit_drives_as_without_and_can_be_ended(tmp_path: Path) -> None:
    limited, wanted = replace(SETUP, plan_limit_s=60.0), run_rollout(SETUP, Drawn())
    mood, process = tmp_path / "mood", tmp_path / "process"
    with PlannerProcess(Moods(tmp_path)) as planner:
        mood.write_text("drive")
        assert_same(run_rollout(limited, planner), wanted)
        assert_same(run_rollout(limited, planner), wanted)
        first = process.read_text()
        mood.write_text("sleep")
        message = r"^planner moods: gave no plan at step 0 within the limit of 0.3 s$"
        with pytest.raises(ValueError, match=message):
            run_rollout(replace(SETUP, plan_limit_s=0.3), planner)
        assert (tmp_path / "finished").read_text() == process.read_text() == first
        with pytest.raises(ProcessLookupError):
            os.kill(int(first), 0)
        mood.write_text("drive")
        assert_same(run_rollout(limited, planner), wanted)
        assert process.read_text() != first
        mood.write_text("leave")
        message = "planner moods: its process ended in plan with exit code 3"
        with pytest.raises(ValueError, match=message):
            run_rollout(limited, planner)


def test_a_planner_that_cannot_be_moved_to_a_process_is_refused() -> None:
    with pytest.raises(InputError, match=r"cannot be moved to a process of its own .*module:attr"):
        run_rollout(replace(SETUP, plan_limit_s=60.0), Does(lambda *_: None))


@dataclass(frozen=True)
class Buffered:
    """A motion that moves on in one array, and may write into what it sees."""

    name: str = "buffered"
    setting: str = "a"
    writes: bool = False

    def start(self, situation: StartSituation) -> Any:
        self.__dict__["state"] = np.array([40.0, 0.0, 0.0, 5.0])
        return self.__dict__["state"]

    def step(self, state: MotionInput, dt: float) -> Any:
        if self.writes:
            state.ego.size[0] = 30.0
        self.__dict__["state"][0] += 0.5
        return self.__dict__["state"]


def test_a_motion_and_a_controller_of_one_buffer() -> None:
    class OneBuffer(PerfectController):
        buffer = np.zeros((6, 11))

        def execute(
            self, state: Any, waypoints: Any, steps: int, vehicle: VehicleParameters, dt: float
        ) -> Any:
            self.buffer[:] = super().execute(state, waypoints, steps, vehicle, dt)
            return self.buffer

    setup = replace(SETUP, motion=Buffered())
    rollout = run_rollout(replace(setup, controller=OneBuffer()), ConstantVelocity())
    assert rollout.actor[:, 0] == pytest.approx(40.0 + 0.5 * np.arange(21))
    wanted = run_rollout(replace(setup, controller=PerfectController()), ConstantVelocity())
    assert_same(rollout, wanted)
    with pytest.raises(InputError, match="motion buffered: step 0: writes into a read-only object"):
        run_rollout(replace(SETUP, motion=Buffered(writes=True)), ConstantVelocity())


class OneImage:
    """A renderer that draws into one buffer."""

    mounts = {"front": CameraMount(PinholeCamera(8, 4, 5.0, 5.0, 4.0, 2.0), np.eye(4))}  # noqa: RUF012
    image = np.zeros((4, 8, 3), np.uint8)

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Any]:
        self.image[:] = state.step
        return dict.fromkeys(camera_names, self.image)


class Keeps(ConstantVelocity):
    needs_images, camera_names = True, ("front",)

    def reset(self, context: Any) -> None:
        super().reset(context)
        self.seen: list[PlannerInput] = []

    def plan(self, observation: PlannerInput) -> Plan:
        self.seen.append(observation)
        return super().plan(observation)


def test_images_that_were_seen_stay() -> None:
    planner = Keeps()
    setup = replace(SETUP, camera_names=("front",))
    run_rollout(setup, planner, OneImage(), lambda _, images: images["front"].fill(99))
    assert [one.images["front"].max() for one in planner.seen] == [0, 5, 10, 15]
    with pytest.raises(ValueError, match="read-only"):
        planner.seen[0].images["front"][:] = 0


def test_a_rollout_is_read_only() -> None:
    rollout = run_rollout(SETUP, ConstantVelocity())
    with pytest.raises(ValueError, match="read-only"):
        rollout.ego[0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        rollout.actor_size[0] = 9.0
