"""Your own planner in a closed loop: python examples/4_rollout.py LOG_FOLDER TRACK MOTION OUT."""

import sys

import numpy as np

import recast


class Careful:
    """Drives straight on at 80 % of its speed."""

    name, needs_images = "careful", True

    def reset(self, context) -> None:  # recast.planning.PlanningContext
        self.times = context.dt * np.arange(1, 41)

    def plan(self, observation: recast.PlannerInput) -> recast.Plan:
        waypoints = np.zeros((40, 3))  # x forward, y left, heading; 0.1 s apart
        waypoints[:, 0] = 0.8 * observation.ego.vx * self.times
        return recast.Plan(waypoints)


def main(source: str, track: str, motion: str, out: str, iterations: str = "2800") -> None:
    log = recast.load_log(source)
    scene = recast.reconstruct(log, scale=0.5, iterations=int(iterations))
    planner, actors = Careful(), {track: recast.motion(motion)}
    sim = recast.Simulator(log, scene, actors, scale=0.5, planner=planner.name)
    observation = sim.reset()
    planner.reset(sim.context)
    while not sim.done:
        observation = sim.step(planner.plan(observation))  # observation.images: by camera
    for name, metric in recast.score(sim.rollout).values.items():
        print(f"{name:24s} {metric.value if metric.valid else metric.reason}")
    print(recast.write_report(sim.rollout, out))


if __name__ == "__main__":
    main(*sys.argv[1:])
