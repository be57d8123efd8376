"""Sizes as people write them: 256MB, 1.5 GiB, 4096."""

from __future__ import annotations

import re

from recast.errors import InputError

_UNITS = {
    "": 1, "b": 1, "kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12,
    "kib": 2**10, "mib": 2**20, "gib": 2**30, "tib": 2**40,
}  # fmt: skip


def parse_byte_size(text: str, option: str) -> int:
    """Bytes of a size such as "256MB" (10^6) or "256MiB" (2^20).

    Args:
        text: number and unit.
        option: that the user gave it as, for the message.

    Raises:
        InputError: no such unit, less than one byte, or 2^63 and more.
    """
    found = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]+)?)\s*([A-Za-z]*)\s*", text)
    size = float(found[1]) * _UNITS.get(found[2].lower(), 0) if found else 0
    if not 1 <= size < 2**63:
        raise InputError(option, "value", f"is {text!r}", "give a size such as 256MB or 1GiB")
    return round(size)
