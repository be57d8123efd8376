"""A street and a car of few triangles, for tests that need many frames."""

from __future__ import annotations

import numpy as np
import pytest

from recast.geometry import boxes
from recast.logs import HdMap, Lane
from recast.synthetic import populate
from recast.synthetic.surface import Surface, concatenate
from recast.synthetic.world import ParkingSpot, Sky, Street, VehicleModel, World

WIDTH = 3.5
BLOCK = 40.0
QUADS = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]


def box_surface(size, colour=(0.6, 0.1, 0.1), material="paint", centre=(0.0, 0.0, 0.0)) -> Surface:
    vertices = boxes.corners(size) + np.asarray(centre)
    faces = [[a, b, c] for q in QUADS for a, b, c in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]
    return Surface.make(vertices, faces, colour, material, crease=0.0)


def box_car(rng: np.random.Generator, kind: str | None = None) -> VehicleModel:
    size = np.array([rng.uniform(4.0, 4.8), rng.uniform(1.75, 1.9), rng.uniform(1.45, 1.7)])
    colour = rng.uniform(0.05, 0.8, 3)
    return VehicleModel(kind or "sedan", "car", "some", size, box_surface(size, colour))


def small_street(kind: str = "urban-straight", length: float = 120.0, bend: float = 0.0) -> Street:
    """Two lanes one way (f1 left of f2), one the other (b1), and parking on the right.

    Args:
        bend: radians that the road turns to the left, evenly, over its middle 60 m.
    """
    s = np.arange(-100.0, length + 160.0, 2.0)
    turn = bend * np.clip((s - 10.0) / 60.0, 0.0, 1.0)
    steps = 2.0 * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    middle = np.cumsum(steps, axis=0) + np.array([-100.0, 0.0])
    left = np.stack([-np.sin(turn), np.cos(turn)], axis=-1)
    lanes: dict[str, Lane] = {}
    per_block = int(BLOCK / 2.0)
    blocks = [(i, min(i + per_block, len(s) - 1)) for i in range(0, len(s) - 1, per_block)]
    for name, lateral, reverse in (("f1", 0.0, False), ("f2", -WIDTH, False), ("b1", WIDTH, True)):
        for number, (first, last) in enumerate(blocks):
            rows = slice(first, last + 1)
            lines = [
                np.c_[
                    middle[rows] + (lateral + side * WIDTH / 2) * left[rows],
                    np.zeros(last - first + 1),
                ]
                for side in (0, 1, -1)
            ]
            if reverse:
                lines = [lines[0][::-1], lines[2][::-1], lines[1][::-1]]
            ahead = number - 1 if reverse else number + 1
            lane_id = f"{name}-{number:02d}"
            lanes[lane_id] = Lane(
                lane_id,
                *lines,
                polygon=np.concatenate([lines[2][:, :2], lines[1][::-1, :2]]),
                speed_limit=13.9,
                successors=(f"{name}-{ahead:02d}",) if 0 <= ahead < len(blocks) else (),
                left_neighbour=f"f1-{number:02d}" if name == "f2" else None,
                right_neighbour=f"f2-{number:02d}" if name == "f1" else None,
            )
    area = np.concatenate([middle - 8.0 * left, (middle + 6.0 * left)[::-1]])
    spots = tuple(
        ParkingSpot(*(middle[i] - 6.7 * left[i]), float(turn[i])) for i in range(10, len(s) - 10, 4)
    )
    route = tuple(f"f1-{number:02d}" for number in range(len(blocks)))
    sun = np.array([0.3, -0.5, 0.8])
    sky = Sky(
        sun / np.linalg.norm(sun), np.array([2.5, 2.4, 2.2]), np.full(3, 0.4), np.full(3, 0.8)
    )
    return Street(kind, _ground(), HdMap(lanes, (area,)), route, 9.0, spots, sky)


def _ground() -> Surface:
    side = 400.0
    plane = Surface.make(
        [[-side, -side, 0], [side, -side, 0], [side, side, 0], [-side, side, 0]],
        [[0, 1, 2], [0, 2, 3]],
        (0.18, 0.18, 0.18),
        "asphalt",
    )
    houses = [
        box_surface((8.0, 8.0, 9.0), (0.5, 0.4, 0.3), "plaster", (x, side_y, 4.5))
        for x in range(-50, 300, 14)
        for side_y in (-18.0, 18.0)
    ]
    return concatenate([plane, *houses])


SECONDS = 0.6


def small_world(seed: int = 0, seconds: float = SECONDS, kind: str = "urban-straight") -> World:
    """A world of few triangles."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(populate, "sample_vehicle", box_car)
        return populate.populate(small_street(kind), kind, seed, seconds)
