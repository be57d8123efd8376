"""Which camera shows something best."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from recast.reporting.inputs import NotMade, RolloutPart


def filmed_cameras(parts: Iterable[RolloutPart]) -> tuple[str, ...]:
    """Names of all cameras that some rollout has a film of, in the order of the films."""
    return tuple(
        dict.fromkeys(
            name for part in parts if not isinstance(part.films, NotMade) for name in part.films
        )
    )


def camera_towards(
    names: Iterable[str], headings: Mapping[str, float], bearing: float = 0.0
) -> str | None:
    """The camera whose heading is nearest to a bearing; the first if no heading is known.

    Args:
        names: to choose among; None is returned if there are none.
        headings: radians by name, 0 ahead, positive to the left.
        bearing: radians, likewise.
    """

    def away(name: str) -> float:
        if name not in headings:
            return np.inf
        return abs(float(np.angle(np.exp(1j * (headings[name] - bearing)))))

    return min(names, key=away, default=None)
