"""Screening of pseudo-targets by a person: decisions in the cache, and a page to make them.

The server of the page is in `recast.recar.screening.server`. See docs/data.md.
"""

from recast.recar.screening.service import Catalogue, Entry, Filter
from recast.recar.targets.decisions import (
    DECISIONS,
    SCREENING_FILE,
    Conflict,
    Decision,
    DecisionChange,
    Screening,
    ScreeningRecord,
)

__all__ = [
    "DECISIONS",
    "SCREENING_FILE",
    "Catalogue",
    "Conflict",
    "Decision",
    "DecisionChange",
    "Entry",
    "Filter",
    "Screening",
    "ScreeningRecord",
]
