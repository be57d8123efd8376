"""What every part of a report is made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Picture = Path | NDArray[np.uint8]
"""A PNG or JPEG file, or (H, W, 3) RGB or (H, W, 4) RGBA uint8."""


SIDES = ("front", "front left", "left", "rear left", "rear", "rear right", "right", "front right")
"""Of a vehicle, by azimuth in steps of 45 degrees."""


@dataclass(frozen=True)
class NotMade:
    """Stands where a part is missing.

    Attributes:
        reason: in words, shown on the page.
    """

    reason: str = "this run did not make it"


NOT_MADE = NotMade()


@dataclass(frozen=True)
class Fact:
    """One line of a list of facts.

    Attributes:
        name, value: for people, with units.
        help: what it means, shown on hover, or None.
    """

    name: str
    value: str
    help: str | None = None
