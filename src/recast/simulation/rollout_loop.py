"""The closed loop: a planner drives a simulator from start to end."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from recast.planning import Planner, planner_cameras
from recast.simulation.plan_limit import ask
from recast.simulation.recorded_road import refuse_if_too_short
from recast.simulation.renderer import SensorRenderer
from recast.simulation.rollout import Rollout
from recast.simulation.setup import RolloutSetup
from recast.simulation.simulator import Simulator, Timings
from recast.simulation.state import SimState

Image = NDArray[np.uint8]

OnFrame = Callable[[SimState, Mapping[str, Image]], None]
"""Called with each state k = 0 .. S-1 in order and its images."""


def run_rollout(
    setup: RolloutSetup,
    planner: Planner,
    renderer: SensorRenderer | None = None,
    on_frame: OnFrame | None = None,
    timings: Timings | None = None,
) -> Rollout:
    """Run one rollout; never stopped by a collision.

    Rendered are the planner's cameras at the plan steps if it needs images, the setup's cameras at
    every step if `on_frame` is given, and nothing otherwise.

    Args:
        renderer: needed where anything is rendered.
        on_frame: receives states and images, for a film.
        timings: is added to.

    Raises:
        InputError: see `recast.simulation.rollout_start.start_rollout` and `planner_cameras`; or
            the ego, or an actor that reacts, leaves the recorded road within two plan cycles.
        ValueError: the planner's answer is no plan or took too long, or a renderer is missing.
        Exception: whatever the planner or a motion raises.
    """
    if renderer is None and (planner.needs_images or on_frame is not None):
        who = f"planner {planner.name}" if planner.needs_images else "on_frame"
        raise ValueError(f"run_rollout: {who} needs images, so give a renderer")
    timings = timings or Timings()
    names = tuple(setup.log.cameras if setup.camera_names is None else setup.camera_names)
    seen = planner_cameras(planner, {} if renderer is None else renderer.mounts, names)
    filmed = () if on_frame is None else names
    simulator = Simulator.from_setup(
        setup, renderer, cameras=seen, planner=planner.name, timings=timings
    )
    planner.reset(simulator.context)
    while not simulator.done:
        first = simulator.step_number
        # One call for both, since a renderer may draw its cameras side by side.
        images = simulator.render(tuple(dict.fromkeys(seen + filmed)) if seen else ())
        observation = simulator.observe({name: images[name] for name in seen})
        plan, took = ask(planner, observation, setup.plan_limit_s)
        timings.plan += took
        kept = simulator.advance(plan)
        if on_frame is None:
            continue
        for step in range(first, first + kept):
            if step > first or not images:
                images = simulator.render(filmed, step)
            on_frame(simulator.state_at(step), {name: images[name] for name in filmed})
    refuse_if_too_short(setup, simulator.step_number, simulator.cut_reason)
    return simulator.rollout
