"""One number with its validity and the reason for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Metric:
    """A metric of one rollout.

    Attributes:
        value: the number, or None where it cannot be told (no map, no plan, no route).
        reason: in words, why the value is not the best possible or why there is none; None where
            there is nothing to explain.
    """

    value: float | None
    reason: str | None = None

    @property
    def valid(self) -> bool:
        """Whether there is a value."""
        return self.value is not None

    def to_json(self) -> dict[str, Any]:
        """Plain value, validity and reason."""
        return {"value": self.value, "valid": self.valid, "reason": self.reason}


def invalid(reason: str) -> Metric:
    """A metric without a value."""
    return Metric(None, reason)
