"""Refusing impossible sizes and unknown names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from recast.errors import InputError


def require_size(where: str, field: str, value: float, least: float, greatest: float) -> float:
    """The value, when it is a finite number of metres in [least, greatest]; else `InputError`."""
    if not np.isfinite(value) or not least <= value <= greatest:
        raise InputError(
            where, field, f"{value} is not possible", f"give metres from {least:g} to {greatest:g}"
        )
    return float(value)


def require_count(where: str, field: str, value: int, least: int, greatest: int) -> int:
    """The value, when it is a whole number in [least, greatest]; else `InputError`."""
    if not np.isfinite(value) or value != int(value) or not least <= value <= greatest:
        raise InputError(
            where, field, f"{value} is not possible", f"give a number from {least} to {greatest}"
        )
    return int(value)


def require_known(where: str, field: str, value: str, known: Sequence[str]) -> str:
    """The value, when it is one of the known; else `InputError` that lists them."""
    if value not in known:
        raise InputError(where, field, f"'{value}' is unknown", f"use one of {', '.join(known)}")
    return value
