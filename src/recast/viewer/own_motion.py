"""A motion put together on the page: its numbers, its start dragged, and its scenario file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import numpy as np
import yaml
from numpy.typing import NDArray

from recast import storage
from recast.dynamics import EgoState
from recast.errors import InputError
from recast.names import folder_name
from recast.simulation import (
    PreparedRollout,
    ScriptedMotion,
    motion_of_record,
    scenario_record,
)
from recast.simulation.motions import Stationary
from recast.simulation.scenario_parts import target_motion
from recast.simulation.scenario_schema import MOTION_SCHEMAS, Quantity, kind_of, motion_numbers

Array = NDArray[np.float64]

SETTING = "page"
"""Setting of the motions that are put together on the page."""


def quantities(motion: ScriptedMotion) -> Mapping[str, Quantity]:
    """The numbers that can be set of what the target does, by name."""
    kind = kind_of(target_motion(motion))
    return {} if kind is None else MOTION_SCHEMAS[kind].quantities


def changed(
    motion: ScriptedMotion, name: str, values: Mapping[str, float | None]
) -> ScriptedMotion:
    """What the target does, under another name and with other numbers; without further actors.

    Args:
        values: by quantity; None leaves an optional one out.

    Raises:
        InputError: a name or number that no scenario file may have.
    """
    target = target_motion(motion)
    kept = {key: float(value) for key, value in values.items() if value is not None}
    record = {
        **scenario_record(cast(ScriptedMotion, target)),
        "name": name,
        "settings": {SETTING: kept},
    }
    return motion_of_record(record, "page")


def dragged(motion: ScriptedMotion, prepared: PreparedRollout, place: Array) -> dict[str, float]:
    """The numbers that put the target where somebody dragged it, as far as it has them.

    Args:
        motion: what the target does now.
        prepared: the rollout of that motion.
        place: (>=2,) where its centre shall start, world metres.

    Returns:
        "gap" or "min_gap", and "lateral", within their ranges and to the centimetre.
    """
    (s, s_new), (lateral, lateral_new) = prepared.route.project(
        np.stack([prepared.actor[0, :2], place[:2]])
    )
    target = target_motion(motion)
    values = motion_numbers(target)
    if isinstance(target, Stationary):  # which may stand further away than its least gap
        speed = float(EgoState(prepared.ego).vx)
        values["min_gap"] = max(target.min_gap, speed**2 / target.braking + target.reserve)
    moved = {"gap": s_new - s, "min_gap": s_new - s, "lateral": lateral_new - lateral}
    found = {}
    for name, by in moved.items():
        known = quantities(motion).get(name)
        if known is not None and name in values:
            value = min(max(values[name] + float(by), known.low), known.high)
            found[name] = round(value, 2)
    return found


def save_scenario(motion: ScriptedMotion, folder: Path) -> Path:
    """Write a scenario file for `recast run --motion`, and return its path.

    Args:
        folder: gets the file, whose name is made from the motion's and leads nowhere else.

    Raises:
        InputError: the motion is none that a file can describe, the file exists, or the disk
            refuses.
    """
    text = yaml.safe_dump(scenario_record(motion), sort_keys=False, allow_unicode=True)
    path = Path(folder) / f"{folder_name(motion.name)}.yaml"
    if path.exists():
        raise InputError(path, "file", "exists already", "give the motion another name")
    with storage.disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    storage.write_text(path, text)
    return path
