"""A small street, ray-cast in numpy: road, kerbs, facades, sky, a moving and a parked car.

Street frame: x along the road, y left, z up, metres, origin on the road.
"""

from __future__ import annotations

import numpy as np

ROAD_HALF_WIDTH = 5.5
KERB = 0.15
FACADE = 9.0
FACADE_HEIGHT = 5.0
CAR_SIZE = np.array([4.2, 1.7, 1.5])
CAR_START = np.array([9.0, 3.4])  # box centre at time 0, in the lane left of the ego
CAR_SPEED = 10.0
PARKED = np.array([24.0, -4.4])
FACES = {  # colours by outward direction in the car frame: what the tests tell sides by
    "front": (230, 200, 40),
    "rear": (190, 30, 30),
    "left": (40, 160, 60),
    "right": (40, 70, 190),
    "top": (150, 150, 155),
}


def car_centre(seconds: np.ndarray) -> np.ndarray:
    """Box centres (..., 3) of the moving car, which drives along x."""
    seconds = np.asarray(seconds, np.float64)
    x = CAR_START[0] + CAR_SPEED * seconds
    return np.stack([x, np.full_like(x, CAR_START[1]), np.full_like(x, CAR_SIZE[2] / 2)], axis=-1)


def parked_centre() -> np.ndarray:
    """Box centre (3,) of the parked car."""
    return np.array([*PARKED, CAR_SIZE[2] / 2])


def cast(
    origins: np.ndarray, directions: np.ndarray, seconds: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nearest hit of rays.

    Args:
        origins, directions: (N, 3), unit directions.
        seconds: (N,) when each ray is sent; the moving car stands accordingly.

    Returns:
        distances (N,), infinite for the sky, and colours (N, 3) in [0, 255].
    """
    parked = np.broadcast_to(parked_centre(), origins.shape)
    moving = car_centre(seconds)
    distances = np.stack(
        [
            np.full(len(origins), np.inf),
            _to_ground(origins, directions),
            _to_upright(origins, directions, ROAD_HALF_WIDTH, 0.0, KERB),
            _to_upright(origins, directions, -ROAD_HALF_WIDTH, 0.0, KERB),
            _to_upright(origins, directions, FACADE, KERB, FACADE_HEIGHT),
            _to_upright(origins, directions, -FACADE, KERB, FACADE_HEIGHT),
            _to_car(origins, directions, moving),
            _to_car(origins, directions, parked),
        ]
    )
    nearest = distances.argmin(axis=0)
    best = distances[nearest, np.arange(len(origins))]
    colours = np.empty((len(origins), 3))
    for surface in range(len(distances)):
        seen = nearest == surface
        hits = origins[seen] + np.where(surface, best[seen], 0.0)[:, None] * directions[seen]
        if surface == 0:
            colours[seen] = _sky_colour(directions[seen])
        elif surface == 1:
            colours[seen] = _ground_colour(hits)
        elif surface < 6:
            colours[seen] = _wall_colour(hits)
        else:
            colours[seen] = _car_colour(hits - (moving if surface == 6 else parked)[seen])
    return best, colours


def _sky_colour(directions: np.ndarray) -> np.ndarray:
    height = np.clip(directions[:, 2:3], 0.0, 1.0)
    return np.array([205.0, 220.0, 235.0]) + height * np.array([-120.0, -80.0, -10.0])


def _ripple(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A texture in [-1, 1] without repetition over a street."""
    waves = np.sin(2.1 * u + 0.7 * v) + np.sin(0.9 * u - 3.3 * v + 1.0)
    return (waves + np.sin(5.7 * u + 1.9) * np.sin(4.3 * v)) / 3


def _to_ground(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Road at height 0 between the kerbs, paths at kerb height beyond."""
    down = np.minimum(directions[:, 2], -1e-6)
    road, path = -origins[:, 2] / down, (KERB - origins[:, 2]) / down
    on_path = np.abs(origins[:, 1] + path * directions[:, 1]) >= ROAD_HALF_WIDTH
    on_road = np.abs(origins[:, 1] + road * directions[:, 1]) < ROAD_HALF_WIDTH
    distance = np.where(on_path, path, np.where(on_road, road, np.inf))
    return np.where(directions[:, 2] < -1e-6, distance, np.inf)


def _ground_colour(hits: np.ndarray) -> np.ndarray:
    x, y, z = hits.T
    on_path = z > KERB / 2
    colour = np.where(on_path[:, None], [110.0, 140.0, 80.0], [95.0, 95.0, 100.0])
    colour += 18 * _ripple(x, y)[:, None]
    dash = (np.abs(np.abs(y) - 1.75) < 0.1) & (x % 4.0 < 2.0)
    colour[dash] = [235.0, 235.0, 230.0]
    return colour


def _to_upright(
    origins: np.ndarray, directions: np.ndarray, y: float, low: float, high: float
) -> np.ndarray:
    across = np.where(np.abs(directions[:, 1]) > 1e-9, directions[:, 1], 1e-9)
    distance = (y - origins[:, 1]) / across
    height = origins[:, 2] + distance * directions[:, 2]
    return np.where((distance > 0) & (height >= low) & (height <= high), distance, np.inf)


def _wall_colour(hits: np.ndarray) -> np.ndarray:
    x, y, z = hits.T
    window = (x % 3.0 < 1.3) & ((z - 1.0) % 2.2 < 1.1) & (z > 1.0)
    colour = np.where(window[:, None], [60.0, 75.0, 95.0], [175.0, 140.0, 115.0])
    return colour + 20 * _ripple(x, z + y)[:, None]


def _to_car(origins: np.ndarray, directions: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Slab test against boxes (N of them, one a ray) that face along x."""
    safe = np.where(np.abs(directions) > 1e-9, directions, 1e-9)
    towards = (centres - origins) / safe
    reach = CAR_SIZE / 2 / np.abs(safe)
    enter, leave = towards - reach, towards + reach
    first = np.maximum(np.maximum(enter[:, 0], enter[:, 1]), enter[:, 2])
    last = np.minimum(np.minimum(leave[:, 0], leave[:, 1]), leave[:, 2])
    return np.where((first > 0) & (first <= last), first, np.inf)


def _car_colour(local: np.ndarray) -> np.ndarray:
    scaled = local / (CAR_SIZE / 2)
    axis = np.abs(scaled).argmax(axis=1)
    outward = np.sign(scaled[np.arange(len(scaled)), axis])
    colour = np.zeros((len(local), 3))
    for name, (along, sign) in {
        "front": (0, 1),
        "rear": (0, -1),
        "left": (1, 1),
        "right": (1, -1),
        "top": (2, 1),
    }.items():
        colour[(axis == along) & (outward == sign)] = FACES[name]
    glass = (local[:, 2] > 0.15) & (local[:, 2] < 0.6) & (axis < 2)
    colour[glass] = 0.35 * colour[glass] + 20.0
    return colour
