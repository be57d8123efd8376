"""What a wrong verdict is made of: arms that differ from one another in one part alone.

The word "decomposition" names a list of such arms; see docs/bench.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from recast.evaluation.verdict_parts import Part
from recast.pipeline.arms import OWN_STREET, TRUTH, Arm

DECOMPOSITION = "decomposition"
"""The word for `decomposition_arms`."""
_LEFT_OUT = {"light": "relit", "refinement": "refine"}
"""Parts that an arm of its own leaves out, and the member that says so."""


def decomposition_arms() -> tuple[Arm, ...]:
    """Truth and reconstruction of street and vehicle in all pairings, and the vehicle without the
    light of its place and without its refinement."""
    replaced = Arm.replaced()
    return (
        Arm.native(),
        replaced,
        Arm.oracle(),
        Arm.oracle(OWN_STREET),
        Arm.replaced(street=TRUTH),
        replaced.model_copy(update={"name": "replaced, unlit", "relit": False}),
        replaced.model_copy(update={"name": "replaced, unrefined", "refine": False}),
        Arm.empty(TRUTH),
        Arm.empty(),
    )


def parts_of(arms: Sequence[Arm]) -> tuple[Part, ...]:
    """Every pair of arms that differ in one part alone, part by part.

    Args:
        arms: arms with the run's settings filled in, see `RunConfig.arm`.
    """
    arms = [arm for arm in arms if arm.noise is None]
    without = {
        part: [(one, other) for one in arms for other in arms if _lacks(other, one, member)]
        for part, member in _LEFT_OUT.items()
    }
    lacking = [other.name for pairs in without.values() for _, other in pairs]
    whole = [arm for arm in arms if arm.name not in lacking]
    pairs = [(one, other) for one in whole for other in whole]
    found = {
        "street": [pair for pair in pairs if _other_street(*pair)],
        "vehicle": [pair for pair in pairs if _other_vehicle(*pair, ("generated", "own"))],
        **without,
        "no vehicle": [pair for pair in pairs if _other_vehicle(*pair, ("none",))],
    }
    return tuple(
        Part(name, one.name, other.name) for name, both in found.items() for one, other in both
    )


def _lacks(arm: Arm, other: Arm, member: str) -> bool:
    """Whether an arm is another one but for a part that it leaves out."""
    return (
        getattr(arm, member) is False
        and getattr(other, member) is not False
        and _members(arm, member) == _members(other, member)
    )


def _other_street(true: Arm, arm: Arm) -> bool:
    return (
        not true.reconstructs
        and arm.reconstructs
        and _members(true, "street") == _members(arm, "street")
    )


def _other_vehicle(true: Arm, arm: Arm, vehicles: Sequence[str]) -> bool:
    return true.vehicle == "truth" and arm.vehicle in vehicles and true.street == arm.street


def _members(arm: Arm, *left_out: str) -> dict[str, Any]:
    return arm.model_dump(exclude={"name", *left_out})
