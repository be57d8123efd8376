"""One time step and one vehicle reach controller, planner, actor and metrics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from moved_worlds import curved_world

from recast.core.errors import InputError
from recast.dynamics import PACIFICA, VehicleParameters
from recast.dynamics import state as ego
from recast.logs.hdmap import HdMap
from recast.logs.types import DrivingLog
from recast.metrics import rollout_metrics
from recast.planning import (
    ConstantVelocity,
    IdmLaneFollower,
    LogReplay,
    Plan,
    Planner,
    PlannerInput,
    PlanningContext,
    ReferenceRoute,
)
from recast.planning.pdm import PdmClosedPlanner
from recast.simulation import (
    MOTIONS,
    LqrController,
    PerfectController,
    RolloutSetup,
    Stationary,
    run_rollout,
)
from support.synthetic_drives import drive

TRUCK = VehicleParameters(width=2.5, front_length=9.0, rear_length=3.0, wheelbase=6.5)


def setup_of(log: DrivingLog, motion: str, dt: float, seconds: float) -> RolloutSetup:
    return RolloutSetup(
        log, "7", MOTIONS[motion], dt=dt, steps=round(seconds / dt), plan_every=round(0.5 / dt)
    )


@pytest.mark.parametrize(
    ("make", "log", "motion", "seconds"),
    [
        (ConstantVelocity, drive(speed=10.0), "stationary-a", 8.0),
        (LogReplay, drive(speed=10.0, curvature=0.01), "advancing-a", 8.0),
        (IdmLaneFollower, drive(speed=10.0), "stationary-a", 8.0),
        (IdmLaneFollower, drive(speed=10.0), "cut-in-b", 8.0),
        (PdmClosedPlanner, curved_world(speed=8.0), "cut-in-a", 3.0),
    ],
)
@pytest.mark.parametrize("controller", [LqrController(), PerfectController()])
def test_half_the_step_moves_ego_and_actor_alike(
    make: Callable[[], Planner],
    log: DrivingLog,
    motion: str,
    seconds: float,
    controller: LqrController | PerfectController,
) -> None:
    coarse, fine = (
        run_rollout(
            replace(setup_of(log, motion, dt, seconds), controller=controller),
            make(),
        )
        for dt in (0.1, 0.05)
    )
    assert fine.steps_run == 2 * coarse.steps_run
    # Forward Euler lags by less than a step: no further apart than the way of a coarse step.
    one_step = 0.1 * 10.0
    for found, expected in ((fine.ego[::2], coarse.ego), (fine.actor[::2], coarse.actor)):
        assert np.linalg.norm(found[:, :2] - expected[:, :2], axis=1).max() < one_step
    metrics = rollout_metrics(fine, log.map)
    assert metrics.collision.nc.value == rollout_metrics(coarse, log.map).collision.nc.value


def test_a_straight_drive_at_constant_speed_is_the_same_for_any_step() -> None:
    for dt in (0.05, 0.1, 0.2):
        rollout = run_rollout(setup_of(drive(speed=10.0), "cut-in-a", dt, 6.0), ConstantVelocity())
        np.testing.assert_allclose(rollout.ego[-1, 0] - rollout.ego[0, 0], 60.0, atol=1e-9)


def test_a_planner_is_told_the_step_and_sees_two_seconds_of_the_past() -> None:
    class Told(ConstantVelocity):
        context: PlanningContext
        history = 0

        def reset(self, context: PlanningContext) -> None:
            self.context = context
            super().reset(context)

        def plan(self, observation: PlannerInput) -> Plan:
            self.history = max(self.history, len(observation.ego_history))
            return super().plan(observation)

    planner = Told()
    run_rollout(setup_of(drive(), "cut-in-a", 0.05, 4.0), planner)
    assert planner.context.dt == 0.05
    assert planner.history == 41


def test_metrics_that_need_other_steps_have_no_value_and_say_so() -> None:
    rollout = run_rollout(setup_of(drive(), "advancing-a", 0.05, 6.0), ConstantVelocity())
    values = rollout_metrics(rollout, None).values
    assert values["nc"].value == 1.0
    assert values["com"].value == 1.0
    assert values["com_driven"].value == 1.0
    assert "reach 2 s ahead" in str(values["ttc"].reason)
    assert "steps of 0.05 s" in str(values["com_nuplan_savgol"].reason)
    assert {name for name, one in values.items() if not one.valid} == {
        "dac",
        "ttc",
        "ttc_constant_velocity",
        "com_nuplan_savgol",
    }


def test_long_steps_look_4_s_ahead_too() -> None:
    rollout = run_rollout(setup_of(drive(), "stationary-a", 0.2, 6.0), ConstantVelocity())
    values = rollout_metrics(rollout, None).values
    assert values["ttc"].value == 0.0  # it drives into what stands
    clear = run_rollout(setup_of(drive(), "advancing-a", 0.2, 6.0), ConstantVelocity())
    assert rollout_metrics(clear, None).values["ttc"].value == 4.0


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("dt", 0.0),
        ("dt", -0.1),
        ("dt", float("nan")),
        ("dt", float("inf")),
        ("dt", 0.02),
        ("dt", 0.5),
        ("dt", 1 / 15),
        ("steps", 0),
        ("plan_every", 0),
        ("plan_every", 41),
        ("road_margin", float("nan")),
    ],
)
def test_a_setup_that_cannot_work_is_refused(field: str, value: float) -> None:
    setup = setup_of(drive(), "cut-in-a", 0.1, 6.0)
    with pytest.raises(InputError, match=f"RolloutSetup: {field}: is "):
        replace(setup, **{field: value})


def test_pdm_closed_refuses_steps_beyond_its_8_s() -> None:
    log = curved_world()
    route = ReferenceRoute.from_trajectory(log.world_from_rig)
    context = PlanningContext(route, log.world_from_rig, log.map, dt=0.25)
    with pytest.raises(InputError, match=r"dt: is 0\.25 s: 40 waypoints exceed its plan of 8 s"):
        PdmClosedPlanner().reset(context)


@pytest.mark.parametrize("vehicle", [PACIFICA, TRUCK])
def test_the_wheelbase_reaches_the_controller(vehicle: VehicleParameters) -> None:
    log = drive(speed=8.0, curvature=0.02)
    setup = replace(setup_of(log, "advancing-a", 0.1, 6.0), vehicle=vehicle)
    states = run_rollout(setup, LogReplay()).ego[1:]
    turn = states[:, ego.VX] * np.tan(states[:, ego.STEERING_ANGLE]) / vehicle.wheelbase
    np.testing.assert_allclose(states[:, ego.ANGULAR_VELOCITY], turn, atol=1e-12)
    assert np.abs(turn).min() > 0.05  # it does turn


@pytest.mark.parametrize("vehicle", [PACIFICA, TRUCK])
def test_the_wheelbase_reaches_the_proposals_of_pdm_closed(vehicle: VehicleParameters) -> None:
    seen: list[np.ndarray] = []

    class Watched(PdmClosedPlanner):
        def plan(self, observation: PlannerInput) -> Plan:
            assert self._pdm is not None
            seen.append(self._pdm.plan(observation.ego, []).simulated[:, 1:])
            return super().plan(observation)

    log = curved_world(bend=0.012)
    setup = replace(setup_of(log, "advancing-a", 0.1, 1.0), vehicle=vehicle)
    run_rollout(setup, Watched())
    states = np.concatenate(seen)
    turn = states[..., ego.VX] * np.tan(states[..., ego.STEERING_ANGLE]) / vehicle.wheelbase
    np.testing.assert_allclose(states[..., ego.ANGULAR_VELOCITY], turn, atol=1e-12)
    assert np.abs(turn).max() > 0.01


def test_a_longer_vehicle_hits_sooner_and_does_not_fit_a_narrow_road() -> None:
    log = drive(speed=10.0)
    lane = np.array([[-20.0, -0.9], [300.0, -0.9], [300.0, 0.9], [-20.0, 0.9]])
    narrow = HdMap(lanes={}, drivable_area=(lane,), derived=True)
    scored, fronts = [], []
    for vehicle in (PACIFICA, TRUCK):
        # the actor stands at the same place for both: its gap is from the ego's front bumper
        gap = 50.0 - vehicle.front_length
        motion = Stationary("far", min_gap=gap, braking=20.0, reserve=0.0)
        setup = RolloutSetup(log, "7", motion, steps=80, vehicle=vehicle)
        rollout = run_rollout(setup, ConstantVelocity())
        metrics = rollout_metrics(rollout, narrow)
        front = rollout.ego[:, 0] + vehicle.front_length
        near_end = rollout.actor[0, 0] - rollout.actor_size[0] / 2
        assert metrics.collision.first_step == int(np.argmax(front > near_end))
        fronts.append(near_end)
        scored.append(metrics)
    car, truck = scored
    np.testing.assert_allclose(*fronts)
    assert truck.collision.first_step < car.collision.first_step  # type: ignore[operator]
    assert (truck.ttc.per_cycle <= car.ttc.per_cycle).all()
    assert (truck.ttc.per_cycle < car.ttc.per_cycle).any()
    # 0.9 m to each side and 0.3 m of tolerance: 1.15 m of half a car fit, 1.25 m of the truck not
    assert (car.drivable.dac.value, truck.drivable.dac.value) == (1.0, 0.0)
