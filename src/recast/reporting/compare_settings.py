"""In which settings several runs differ."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from recast.reporting.compare_inputs import ComparedRun

MISSING = "-"


def differing_settings(runs: Sequence[ComparedRun]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Dotted names of the settings that differ, each with its value in every run."""
    flat = [dict(_flattened(run.settings)) for run in runs]
    names = dict.fromkeys(name for one in flat for name in one)
    rows = ((name, tuple(one.get(name, MISSING) for one in flat)) for name in names)
    return tuple((name, values) for name, values in rows if len(set(values)) > 1)


def _flattened(value: Any, name: str = "") -> list[tuple[str, str]]:
    """Dotted names and values; a list of records with names counts as records by name."""
    if isinstance(value, Sequence) and not isinstance(value, str) and _all_named(value):
        value = {one["name"]: {k: v for k, v in one.items() if k != "name"} for one in value}
    if not isinstance(value, Mapping):
        return [(name, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))]
    return [
        pair
        for key, inner in value.items()
        for pair in _flattened(inner, f"{name}.{key}" if name else str(key))
    ]


def _all_named(values: Sequence[Any]) -> bool:
    return len(values) > 0 and all(isinstance(one, Mapping) and "name" in one for one in values)
