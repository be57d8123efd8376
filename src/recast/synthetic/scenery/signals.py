"""Traffic signals."""

from __future__ import annotations

import numpy as np

from recast.synthetic.scenery.arguments import require_known, require_size
from recast.synthetic.scenery.primitives import FACING_MINUS_X, at, boxes, lathe, tube
from recast.synthetic.surface import Surface, concatenate

SIGNAL_STATES = ("red", "amber", "green", "off")

LIT = {"red": (1.0, 0.03, 0.02), "amber": (1.0, 0.42, 0.0), "green": (0.02, 0.9, 0.35)}
UNLIT = {"red": (0.06, 0.004, 0.004), "amber": (0.06, 0.03, 0.002), "green": (0.003, 0.05, 0.03)}
LAMP_HEIGHTS = {"red": 0.66, "amber": 0.36, "green": 0.06}
"""Metres from the foot of the housing's lowest lamp box to each lamp's box."""

HOUSING = (0.018, 0.02, 0.02)


def traffic_signal(rng: np.random.Generator, state: str = "red", reach: float = 0.0) -> Surface:
    """A signal that faces -x, read by traffic that drives in +x.

    Args:
        rng: chooses the pole's paint and the boards behind the lamps.
        state: "red", "amber", "green" or "off".
        reach: metres of a mast arm to +y, over the road for traffic on the right, with a second
            head at its end; 0 for none, else 2 to 12.

    Raises:
        InputError: for unknown states and impossible reaches.
    """
    require_known("traffic_signal", "state", state, SIGNAL_STATES)
    if reach != 0.0:
        require_size("traffic_signal", "reach", reach, 2.0, 12.0)
    paint, material = [
        ((0.6, 0.61, 0.62), "metal"),
        ((0.02, 0.02, 0.022), "plastic"),
        ((0.2, 0.21, 0.2), "plastic"),
    ][rng.integers(3)]
    bordered = rng.random() < 0.5
    radius = 0.06 if reach == 0.0 else 0.11
    top = 3.6 if reach == 0.0 else 6.2
    pole = lathe(
        [
            (2.2 * radius, -0.2),
            (2.2 * radius, 0.03),
            (1.25 * radius, 0.05),
            (radius, 0.5),
            (0.8 * radius, top),
            (0.0, top + 0.02),
        ],
        10,
        paint,
        material,
    )
    low = at(_head(state, bordered), -0.2, 0.0, 2.45)
    parts = [
        pole,
        low,
        boxes((-0.2, -0.03, 2.6), (0.0, 0.03, 2.66), HOUSING, "plastic"),
        boxes((-0.2, -0.03, 3.2), (0.0, 0.03, 3.26), HOUSING, "plastic"),
    ]
    if reach:
        share = np.linspace(0, 1, 6)
        arm = np.column_stack([0 * share, share * reach, top - 0.35 + 0.35 * np.sin(1.57 * share)])
        parts.append(tube(arm, np.linspace(0.085, 0.05, 6), 8, paint, material))
        parts.append(at(_head(state, bordered), -0.18, reach - 0.15, top - 0.5))
    return concatenate(parts)


def _head(state: str, bordered: bool) -> Surface:
    """Three lamps in a housing 1 m tall, facing -x, its foot at the origin."""
    parts = [boxes((-0.12, -0.16, 0.0), (0.1, 0.16, 1.0), HOUSING, "plastic")]
    if bordered:
        parts.append(boxes((-0.01, -0.27, -0.1), (0.01, 0.27, 1.1), HOUSING, "plastic"))
        edge = np.array(
            [
                (-0.013, -0.27, -0.1),
                (-0.013, 0.245, -0.1),
                (-0.013, -0.27, 1.075),
                (-0.013, -0.27, -0.1),
            ]
        )
        size = np.array(
            [(0.004, 0.025, 1.2), (0.004, 0.025, 1.2), (0.004, 0.54, 0.025), (0.004, 0.54, 0.025)]
        )
        parts.append(boxes(edge, edge + size, (0.6, 0.6, 0.58), "sign"))
    for name, foot in LAMP_HEIGHTS.items():
        centre = foot + 0.14
        lit = name == state
        lens = lathe(
            [(0.105, 0.0), (0.085, 0.025), (0.0, 0.04)],
            14,
            LIT[name] if lit else UNLIT[name],
            "signal" if lit else "plastic",
        )
        parts.append(at(lens.transformed(FACING_MINUS_X), -0.121, 0.0, centre))
        parts.append(_visor(centre))
    return concatenate(parts)


def _visor(centre: float) -> Surface:
    """The hood over a lamp, open below."""
    angle = np.linspace(-0.15 * np.pi, 1.15 * np.pi, 9)
    near = np.column_stack(
        [np.full(9, -0.12), 0.125 * np.cos(angle), centre + 0.125 * np.sin(angle)]
    )
    reach = 0.2 * np.clip(0.55 + 0.45 * np.sin(angle), 0.2, 1.0)
    far = near - np.column_stack([reach, np.zeros(9), np.zeros(9)])
    a = np.arange(8)
    faces = np.concatenate([np.stack([a, a + 1, a + 10], 1), np.stack([a, a + 10, a + 9], 1)])
    both = np.concatenate([faces, faces[:, ::-1]])
    return Surface.make(np.concatenate([near, far]), both, HOUSING, "plastic", 0.0)
