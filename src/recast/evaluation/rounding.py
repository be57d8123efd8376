"""Floats as they are written to files of scores."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

DECIMALS = 6


def rounded(value: Any) -> Any:
    """Plain data with floats of six decimals; JSON knows no NaN and no infinity: they are null."""
    if isinstance(value, Mapping):
        return {key: rounded(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(one) for one in value]
    if isinstance(value, float):
        return round(value, DECIMALS) if math.isfinite(value) else None
    return value
