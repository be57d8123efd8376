"""What every kind of perturbation has in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from recast.records import Record

Picture = NDArray[np.uint8]


def _in_order(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] > interval[1]:
        raise ValueError(f"the first value {interval[0]:g} is above the second {interval[1]:g}")
    return interval


Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Shares = Annotated[tuple[Share, Share], AfterValidator(_in_order)]
Positives = Annotated[tuple[Positive, Positive], AfterValidator(_in_order)]


class Perturbation(Protocol):
    """What spoils a picture of a cut-out object, from not at all to badly."""

    name: ClassVar[str]

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture.

        Args:
            rgba: (H, W, 4) uint8, straight alpha; passes `recast.trellis.check_crop`.
            severity: in [0, 1]; 0 changes next to nothing, 1 as much as the kind's figures say.
            rng: of all that is random; what is drawn does not depend on the severity, so equal
                generators give the same fault, weaker or stronger.

        Returns:
            (H, W, 4) uint8, straight alpha; a new array.
        """
        ...


class Kind(Record, ABC):
    """One kind with its figures, as the configuration holds it.

    Lengths are shares of the object's extent (the longer side of its box), because the model sees
    the object scaled to one size, whatever its size in the log.

    Attributes:
        weight: how often it is drawn, relative to the others; 0 switches it off.
        severity: lowest and highest severity that is drawn, uniformly.
    """

    name: ClassVar[str]

    weight: Weight = 1.0
    severity: Shares = (0.1, 1.0)

    @abstractmethod
    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
