"""The reference map and scenarios, and rigid motions and the mirror image of both."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import shapely

from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning.map import PlannerLane, PlannerMap
from recast.planning.pdm import AgentKind, Obstacle

FOLDER = Path(__file__).parents[2] / "golden" / "planners"
DATA = json.loads((FOLDER / "pdm_map_and_scenarios.json").read_text())
KINDS = {
    "VEHICLE": AgentKind.VEHICLE,
    "PEDESTRIAN": AgentKind.PEDESTRIAN,
    "TRAFFIC_CONE": AgentKind.STATIC,
}


@dataclass(frozen=True)
class Scene:
    planner_map: PlannerMap
    state: np.ndarray
    obstacles: list[Obstacle]
    route: list[str]
    red: list[str]


def golden_map() -> PlannerMap:
    blocks = DATA["roadblocks"]
    lanes = {
        key: PlannerLane(
            lane_id=key,
            block_id=lane["roadblock"],
            centreline=np.array(lane["centerline"]),
            polygon=shapely.Polygon(lane["polygon"]),
            speed_limit=lane["speed_limit_mps"],
            successors=tuple(lane["outgoing"]),
            connector=blocks[lane["roadblock"]]["connector"],
        )
        for key, lane in DATA["lanes"].items()
    }
    return PlannerMap(
        lanes,
        intersections=[shapely.Polygon(p) for p in DATA["intersections"].values()],
        car_parks=[shapely.Polygon(p) for p in DATA["carparks"].values()],
    )


def vehicle(token, x, y, heading, speed, length=4.6, width=1.9, kind="VEHICLE") -> Obstacle:
    velocity = speed * np.array([np.cos(heading), np.sin(heading)])
    return Obstacle(
        token, KINDS[kind], np.array([x, y, heading]), velocity, np.array([length, width])
    )


def ego_state(x, y, heading, vx, ax=0.0, steering=0.0) -> np.ndarray:
    state = np.zeros(ego.SIZE)
    state[ego.POSE] = x, y, heading
    state[ego.VX], state[ego.AX], state[ego.STEERING_ANGLE] = vx, ax, steering
    return state


def golden_scene(name: str) -> Scene:
    scenario = DATA["scenarios"][name]
    return Scene(
        golden_map(),
        ego_state(
            *scenario["ego_rear_axle"], scenario["ego_vx"], scenario["ego_ax"], scenario["steer"]
        ),
        [vehicle(*agent) for agent in scenario["agents"]],
        scenario["route_roadblocks"],
        scenario["red_lane_connectors"],
    )


def moved(scene: Scene, motion: np.ndarray) -> Scene:
    """The scene after a rigid motion (x, y, angle)."""

    def points(xy):
        return se2.compose(motion, np.c_[xy, np.zeros(len(xy))])[:, :2]

    turn = np.array([0.0, 0.0, motion[2]])
    state = scene.state.copy()
    state[ego.POSE] = se2.compose(motion, state[ego.POSE])
    return _changed(
        scene,
        points,
        lambda poses: se2.compose(motion, poses),
        lambda v: se2.compose(turn, np.array([*v, 0.0]))[:2],
        state,
    )


def mirrored(scene: Scene) -> Scene:
    """The scene with left and right exchanged, about the x axis."""
    state = scene.state.copy()
    flipped = [ego.Y, ego.HEADING, ego.VY, ego.AY, *range(ego.STEERING_ANGLE, ego.SIZE)]
    state[flipped] *= -1
    sign = np.array([1.0, -1.0, -1.0])
    return _changed(
        scene, lambda xy: xy * sign[:2], lambda p: p * sign, lambda v: v * sign[:2], state
    )


def _changed(scene, points, poses, velocity, state) -> Scene:
    old = scene.planner_map

    def areas(polygons):
        return [shapely.transform(p, points) for p in polygons]

    lanes = {
        key: replace(
            lane,
            centreline=poses(lane.centreline),
            polygon=shapely.transform(lane.polygon, points),
        )
        for key, lane in old.lanes.items()
    }
    changed = PlannerMap(lanes, areas(old.drivable), areas(old.intersections), areas(old.car_parks))
    obstacles = [
        replace(o, pose=poses(o.pose), velocity=velocity(o.velocity)) for o in scene.obstacles
    ]
    return Scene(changed, state, obstacles, scene.route, scene.red)
