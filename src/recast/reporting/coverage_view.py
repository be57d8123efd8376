"""What of the vehicle a rollout's cameras showed: seen by the log, mirrored or invented."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from recast.actors.coverage import Coverage
from recast.reporting.inputs import ScenarioPart
from recast.simulation.coverage import RolloutCoverage


@dataclass(frozen=True)
class CoverageLine:
    """One rollout.

    Attributes:
        title, anchor: of its scenario, which is the `anchor`-th of the page.
        arm: name for people.
        planned: whether it is about the planner's images; else about all that were recorded.
        mean: over the images; `visible` of `images` show the vehicle.
    """

    title: str
    anchor: int
    arm: str
    planned: bool
    mean: Coverage
    visible: int
    images: int


def looked_at(coverage: RolloutCoverage) -> RolloutCoverage:
    """The images that the planner was given; all for a planner that looks at none."""
    return coverage.of_planner or coverage


def coverage_lines(
    scenarios: Sequence[ScenarioPart], arms: Mapping[str, str]
) -> tuple[CoverageLine, ...]:
    """A line for each rollout whose vehicle has shares, by scenario, then as they are given."""
    return tuple(
        CoverageLine(
            title=scenario.title,
            anchor=number,
            arm=arms[part.arm],
            planned=part.coverage.of_planner is not None,
            mean=looked_at(part.coverage).mean,
            visible=looked_at(part.coverage).visible,
            images=len(looked_at(part.coverage).images),
        )
        for number, scenario in enumerate(scenarios, 1)
        for part in scenario.rollouts
        if part.coverage is not None
    )


def coverage_note(line: CoverageLine) -> str:
    """The line as a sentence."""
    who = "the planner saw" if line.planned else "the cameras showed"
    if line.visible == 0:
        return f"None of the {line.images} images that {who} shows the {line.arm}."
    mean = line.mean
    return (
        f"Of what {who} of the {line.arm}, {mean.invented:.0%} was invented, "
        f"{mean.mirrored:.0%} mirrored and {mean.seen:.0%} seen in the log "
        f"(visible in {line.visible} of {line.images} images)."
    )
