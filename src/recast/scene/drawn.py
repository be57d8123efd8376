"""What one view of a scene under training is made of."""

from __future__ import annotations

from dataclasses import dataclass

from recast.splats import Gaussians


@dataclass(frozen=True)
class Span:
    """Rows of one present actor: `[first, last)` as drawn, `[start, stop)` among all actors' rows.

    Attributes:
        posed: its Gaussians in the world, with the graph back to the parameters and the pose.
    """

    first: int
    last: int
    start: int
    stop: int
    posed: Gaussians


@dataclass(frozen=True)
class Drawn:
    """What one view sees: leaf Gaussians for the rasterizer, and where the actors are in them."""

    gaussians: Gaussians
    spans: tuple[Span, ...]
