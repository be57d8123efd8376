"""What the first screen says beside its pictures: trust, and what of the vehicle was seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from recast.actors.coverage import Coverage
from recast.reporting.checks import Check
from recast.reporting.coverage_view import looked_at
from recast.reporting.inputs import NotMade, ReportInputs


@dataclass(frozen=True)
class Glance:
    """Numbers for the first screen.

    Attributes:
        counts: how many checks are good, bad, and need care.
        coverage: of the vehicle over all images of all rollouts; None without shares.
    """

    counts: tuple[tuple[str, int], ...]
    coverage: Coverage | None


def glance(run: ReportInputs, checks: Sequence[Check]) -> Glance:
    """Count the checks, and gather the coverage of all rollouts."""
    tones = [check.tone for check in checks]
    parts = () if isinstance(run.scenarios, NotMade) else run.scenarios
    images = [
        image.coverage
        for scenario in parts
        for part in scenario.rollouts
        if part.coverage is not None
        for image in looked_at(part.coverage).images
    ]
    mean = Coverage.mean(images)
    return Glance(
        counts=tuple((tone, tones.count(tone)) for tone in ("good", "bad", "warn")),
        coverage=mean if mean.pixels > 0 else None,
    )
