"""One colour for one thing, in every drawing of the report (RGB, 0..255).

The map is dark and arms are of middle lightness: both read alike on light and dark pages.
"""

from __future__ import annotations

from collections.abc import Mapping

Colour = tuple[int, int, int]

EGO: Colour = (86, 164, 255)
ACTOR: Colour = (255, 159, 67)
PLAN: Colour = (94, 226, 160)
LOGGED: Colour = (150, 160, 176)
COLLISION: Colour = (255, 82, 82)
TEXT: Colour = (232, 236, 242)
GROUND: Colour = (22, 25, 31)
GRID: Colour = (32, 36, 44)
DRIVABLE: Colour = (46, 52, 62)
BOUNDARY: Colour = (104, 114, 130)
CENTRELINE: Colour = (78, 88, 104)
ROUTE: Colour = (70, 96, 130)
SHARES: Mapping[str, Colour] = {
    "seen": (40, 130, 220),
    "mirrored": (245, 205, 60),
    "invented": (214, 60, 90),
}
"""Where a vehicle's looks come from; told apart by people who cannot tell red, green or blue."""
ARMS: tuple[Colour, ...] = (
    (133, 104, 224),
    (16, 150, 140),
    (206, 72, 126),
    (140, 132, 40),
    (70, 120, 200),
)


def arm_colour(index: int) -> Colour:
    """Colour of the `index`-th arm of a report; repeats after the last."""
    return ARMS[index % len(ARMS)]


def css(colour: Colour) -> str:
    """`#rrggbb`."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def dimmed(colour: Colour, share: float) -> Colour:
    """`colour` mixed with the ground, `share` in [0, 1] of it left."""
    red, green, blue = (
        round(share * c + (1 - share) * g) for c, g in zip(colour, GROUND, strict=True)
    )
    return red, green, blue
