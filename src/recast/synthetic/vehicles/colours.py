"""Paint colours and how often they are met on the road."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from recast.errors import InputError


class PaintColour(NamedTuple):
    """A paint.

    Attributes:
        rgb: linear reflectance.
        share: of all passenger cars on the road; the shares add up to 1.
    """

    rgb: tuple[float, float, float]
    share: float


COLOURS: dict[str, PaintColour] = {
    "white": PaintColour((0.78, 0.78, 0.76), 0.35),
    "black": PaintColour((0.012, 0.012, 0.014), 0.22),
    "grey": PaintColour((0.12, 0.125, 0.13), 0.18),
    "silver": PaintColour((0.42, 0.43, 0.44), 0.10),
    "blue": PaintColour((0.025, 0.075, 0.26), 0.07),
    "red": PaintColour((0.38, 0.018, 0.02), 0.04),
    "green": PaintColour((0.03, 0.11, 0.06), 0.012),
    "beige": PaintColour((0.48, 0.40, 0.28), 0.01),
    "brown": PaintColour((0.10, 0.055, 0.03), 0.008),
    "orange": PaintColour((0.62, 0.16, 0.015), 0.006),
    "yellow": PaintColour((0.75, 0.48, 0.03), 0.004),
}
"""By name. Shares are rounded from industry surveys of car paint (white, black, grey and silver
make up about five cars in six)."""

_KIND_SHARES: dict[str, dict[str, float]] = {
    "van": {"white": 0.66, "grey": 0.10, "silver": 0.09, "black": 0.07, "blue": 0.05, "red": 0.03},
    "box-truck": {"white": 0.76, "blue": 0.08, "red": 0.06, "grey": 0.05, "yellow": 0.05},
    "bus": {"red": 0.24, "white": 0.22, "blue": 0.18, "yellow": 0.16, "green": 0.12,
            "orange": 0.08},
}  # fmt: skip


def colour_shares(kind: str) -> dict[str, float]:
    """How often each colour is met among vehicles of a kind; adds up to 1."""
    return _KIND_SHARES.get(kind, {name: colour.share for name, colour in COLOURS.items()})


def sample_colour(kind: str, rng: np.random.Generator) -> str:
    """The name of a colour, as often as it is met on the road for that kind."""
    shares = colour_shares(kind)
    weights = np.fromiter(shares.values(), np.float64)
    return list(shares)[int(rng.choice(len(weights), p=weights / weights.sum()))]


def paint_rgb(colour: str, shade: float) -> tuple[float, float, float]:
    """Linear RGB of a named colour, darker or lighter by `shade` in [-1, 1].

    Raises:
        InputError: no such colour.
    """
    if colour not in COLOURS:
        raise InputError("vehicle", "colour", f"{colour!r} is unknown", f"use {', '.join(COLOURS)}")
    factor = 1.0 + (0.12 if colour == "white" else 0.35) * shade
    red, green, blue = (min(channel * factor, 0.85) for channel in COLOURS[colour].rgb)
    return (red, green, blue)
