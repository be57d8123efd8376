"""Running planners: through a rollout, which may fail, and on an empty plane."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np

from recast.arrays import Array
from recast.core.foreign import whole
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.logs.types import DrivingLog, Track, Trajectory
from recast.planning import BasePlanner, Planner, looked_at, planner_cameras
from recast.simulation.motions import Stationary
from recast.simulation.planner_calls import PlannerCalls, PlannerProcess, calling
from recast.simulation.recorded_road import refuse_if_too_short
from recast.simulation.renderer import SensorRenderer
from recast.simulation.rollout import Rollout, RolloutFailure
from recast.simulation.setup import EgoController, LqrController, RolloutSetup
from recast.simulation.simulator import OnFrame, Simulator, Timings

TRACEBACK_LIMIT = 8000
"""Characters of a traceback that a failure keeps: the last ones, which name the place."""
_REASON_LIMIT = 2000
_ROAD = 400.0
"""Metres of made-up straight log, long enough that nothing is cut."""


def run_rollout(
    setup: RolloutSetup,
    planner: Planner,
    renderer: SensorRenderer | None = None,
    on_frame: OnFrame | None = None,
    timings: Timings | None = None,
) -> Rollout:
    """Run one rollout; never stopped by a collision.

    Rendered are the planner's cameras at the plan steps if it needs images, the setup's cameras at
    every step if `on_frame` is given, and nothing otherwise. The planner's images are black outside
    of the windows that it looks at, so that states and plans are the same with and without a film.

    Args:
        renderer: needed where anything is rendered.
        on_frame: receives states and images, for a film.
        timings: timings that are added to.

    Raises:
        InputError: see `recast.simulation.rollout_start.start_rollout` and `planner_cameras`; or
            the ego, or an actor that reacts, leaves the recorded road within two plan cycles.
        ValueError: the planner's answer is no plan or took too long, or a renderer is missing.
        Exception: whatever the planner or a motion raises.
    """
    planner = whole(planner, BasePlanner)
    if renderer is None and (planner.needs_images or on_frame is not None):
        who = f"planner {planner.name}" if planner.needs_images else "on_frame"
        raise ValueError(f"run_rollout: {who} needs images, so give a renderer")
    timings = timings or Timings()
    names = tuple(setup.log.cameras if setup.camera_names is None else setup.camera_names)
    mounts = {} if renderer is None else renderer.mounts
    seen = planner_cameras(planner, mounts, names)
    # What the planner gets must not depend on whether there is a film.
    shown = {name: looked_at(planner, mounts)[name] for name in seen}
    filmed = () if on_frame is None else names
    besides = tuple(name for name in filmed if name not in seen)
    simulator = Simulator(
        setup,
        renderer,
        cameras=seen,
        planner=planner.name,
        timings=timings,
        replays_log=planner.replays_log,
    )
    with calling(planner, setup.plan_limit_s) as calls, _finishing(calls):
        calls.reset(replace(simulator.context, cameras=shown))
        while not simulator.done:
            first = simulator.step_number
            images = simulator.render(seen)
            masked = {name: mount.masked(images[name]) for name, mount in shown.items()}
            observation = simulator.observe(masked, foretold=planner.foresees)
            plan, took = calls.timed_plan(observation, setup.plan_limit_s)
            timings.plan += took
            simulator.warn_of_reach(plan)
            kept = simulator.advance(plan)
            if on_frame is None:
                continue
            for step in range(first, first + kept):
                images = (
                    simulator.render(filmed, step)
                    if step > first
                    else {**images, **simulator.render(besides, step)}
                )
                on_frame(simulator.state_at(step), {name: images[name] for name in filmed})
    refuse_if_too_short(setup, simulator.step_number, simulator.cut_reason)
    return simulator.rollout


@contextmanager
def _finishing(calls: PlannerCalls | PlannerProcess) -> Iterator[None]:
    """Finish the planner's rollout at the end; a fault of the rollout goes before one of that."""
    try:
        yield
    except BaseException:
        with suppress(Exception):
            calls.finish()
        raise
    calls.finish()


def failure(setup: RolloutSetup, planner: str, error: Exception) -> RolloutFailure:
    """The report row of a rollout that raised `error`."""
    return RolloutFailure(
        name=setup.name,
        arm=setup.arm,
        track_id=setup.track_id,
        motion=setup.motion.name,
        setting=setup.motion.setting,
        planner=planner,
        **error_fields(error),
    )


def error_fields(error: BaseException) -> dict[str, str]:
    """The members `error`, `reason` and `traceback` of a `RolloutFailure`."""
    try:
        reason = str(error)
    except Exception as another:  # an exception class of a planner may be faulty itself
        reason = f"its message cannot be read ({type(another).__name__})"
    lines = "".join(traceback.format_exception(error))
    return {
        "error": type(error).__name__,
        "reason": _unicode(reason)[:_REASON_LIMIT],
        "traceback": _unicode(lines)[-TRACEBACK_LIMIT:],
    }


def _unicode(text: str) -> str:
    """Lone surrogates, which no table and no page can hold, escaped."""
    return text.encode("utf-8", "backslashreplace").decode()


def probe_path(
    planner: Planner,
    *,
    speed: float = 8.0,
    steps: int = 40,
    controller: EgoController | None = None,
) -> Array:
    """Drive a planner that needs no images in a closed loop, to see that its frames are right.

    A log is made up for it: straight on at constant speed, and one vehicle that stands far away.
    Give your adapter a model that plans straight on, a left arc and a right arc: on the left arc y
    and heading must grow, on the right one fall.

    Args:
        planner: planner as it would be given to `run_rollout`.
        speed: speed at the start, m/s.
        steps: number of steps of 0.1 s.
        controller: executes the plans; None for the default one.

    Returns:
        (steps + 1, 3) x, y, heading of the rear axle in the frame of the start.

    Raises:
        Exception: see `run_rollout`.
    """
    times = np.arange(round(_ROAD / speed * 10) + 1)
    start = np.array([30.0, -20.0, 0.7])  # not the origin, so that frames cannot be mistaken
    along = np.zeros((len(times), 3))
    along[:, 0] = 0.1 * speed * times
    drive = Trajectory(times.astype(np.int64) * 100_000, se2.to_se3(se2.compose(start, along)))
    parked = se2.to_se3(se2.compose(start, [0.0, 60.0, 0.0]))
    stands = Trajectory(drive.timestamps_us[[0, -1]], np.stack([parked, parked]))
    log = DrivingLog(
        "probe", {}, {}, drive, {"0": Track("0", "car", np.array([4.2, 1.8, 1.5]), stands)}
    )
    setup = RolloutSetup(
        log,
        "0",
        Stationary("a", min_gap=200.0, braking=4.0, reserve=0.0),
        start_timestamp_us=2_000_000,
        steps=steps,
        controller=controller or LqrController(),
    )
    states = run_rollout(setup, planner).ego
    return se2.relative(states[0, ego.POSE], states[:, ego.POSE])
