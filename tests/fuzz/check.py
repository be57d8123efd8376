"""Whether a value that a reader accepted is fit for use: every number in it is finite."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import torch
from pydantic import BaseModel


def first_fault(value: Any) -> str | None:
    """Dotted name of the first number that is not finite, or None."""
    waiting: list[tuple[str, Any]] = [("value", value)]
    seen: set[int] = set()
    while waiting:
        name, one = waiting.pop()
        if isinstance(one, float):
            if not math.isfinite(one):
                return name
        elif isinstance(one, np.ndarray | np.generic):
            if one.dtype.kind in "fc" and not np.isfinite(one).all():
                return name
            if one.dtype.kind in "mM" and np.isnat(one).any():
                return name
        elif isinstance(one, torch.Tensor):
            if one.is_floating_point() and not bool(torch.isfinite(one).all()):
                return name
        elif id(one) not in seen:
            seen.add(id(one))
            waiting += [(f"{name}.{key}", inner) for key, inner in _members(one)]
    return None


def _members(value: Any) -> list[tuple[Any, Any]]:
    if isinstance(value, Mapping):
        return list(value.items())
    if isinstance(value, list | tuple):
        return list(enumerate(value))
    if isinstance(value, BaseModel):
        return list(value)
    if is_dataclass(value) and not isinstance(value, type):
        return [(f.name, getattr(value, f.name)) for f in fields(value)]
    if isinstance(value, torch.nn.Module):
        return [*value.named_parameters(), *value.named_buffers()]
    return []
