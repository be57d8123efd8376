"""What a page shows that sets several runs side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from recast.logs.hdmap import HdMap
from recast.reporting.basics import NOT_MADE, NotMade
from recast.reporting.inputs import ScenarioPart

ScenarioKey = tuple[str, str, str]
"""Motion, setting and planner."""


@dataclass(frozen=True)
class ComparedRun:
    """One of the runs.

    Attributes:
        name: for people.
        log: name of its log; `log_hash` of its contents.
        target: the controlled track.
        arms: arm to its name for people.
        scenarios: by motion, setting and planner.
        settings: JSON-able members, nested as deep as one likes; those that differ are shown.
        hd_map: for the views from above.
        camera_headings: see `ReportInputs`.
    """

    name: str
    log: str
    log_hash: str
    target: str
    arms: Mapping[str, str]
    scenarios: Mapping[ScenarioKey, ScenarioPart]
    settings: Mapping[str, Any] = field(default_factory=dict)
    hd_map: HdMap | NotMade = NOT_MADE
    camera_headings: Mapping[str, float] = field(default_factory=dict)


def letter(number: int) -> str:
    """What the `number`-th run is called on the page: A, B, ... Z, then 27, 28, ..."""
    return chr(ord("A") + number) if number < 26 else str(number + 1)
