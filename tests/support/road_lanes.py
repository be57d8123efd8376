"""Lanes of which maps of tests are made."""

from __future__ import annotations

from typing import Any

import numpy as np

from recast.arrays import Array
from recast.logs.hdmap import Lane


def lane(name: str, angle: float, start: tuple[float, float, float], **links: Any) -> Lane:
    """30 m of a circle, or of a line, climbing; 2 m wide to the left and 1.5 m to the right."""
    s = np.linspace(0, 30, 16)
    heading = start[2] + angle * s / 30
    step = np.stack([np.cos(heading), np.sin(heading)], axis=1) * 2.0
    line = np.array(start[:2]) + np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)[:-1]])
    left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
    height = 0.05 * s[:, None] + 3
    sides = [np.c_[line + by * left, height] for by in (0, 2.0, -1.5)]
    return outlined(name, *sides, speed_limit=13.9, **links)


def outlined(name: str, centre: Array, left: Array, right: Array, **links: Any) -> Lane:
    """A lane between two boundaries."""
    outline = np.concatenate([left[:, :2], right[::-1, :2]])
    return Lane(name, centre, left, right, outline, **links)
