"""What a report shows where the truth is known: the first screen, and views beyond the log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from recast.evaluation import OracleViews
from recast.reporting.basics import Picture

PURPOSE = (
    "The log shows this vehicle only from where the recording car happened to be. recast gives it "
    "a whole body, so that the drive can be driven again with the vehicle doing what it never did, "
    "and the cameras see what they would have seen."
)


@dataclass(frozen=True)
class ShowcasePart:
    """The first screen: one moment that the log never had, seen in several ways.

    Attributes:
        caption: what the pictures show, in a sentence.
        pictures: label to picture, from left to right, the truth last.
        notes: label to the line of numbers under its picture; a label may be missing.
        best: the label whose numbers are nearest to the truth's, or None.
        numbers: one line for all of it.
        purpose: a sentence on what all this is for.
    """

    caption: str
    pictures: Mapping[str, Picture]
    notes: Mapping[str, str] = field(default_factory=dict)
    best: str | None = None
    numbers: str = ""
    purpose: str = PURPOSE


@dataclass(frozen=True)
class TruthPart:
    """Baseline and candidate actor against the truth, over the angle from the log.

    Attributes:
        views: the comparison.
        names: "baseline", "candidate" and "truth" to their names for people.
        colours: "baseline" and "candidate" to the indices of their arms' colours.
        pictures: index of a view to its picture: baseline, candidate and truth side by side.
    """

    views: OracleViews
    names: Mapping[str, str]
    colours: Mapping[str, int]
    pictures: Mapping[int, Picture] = field(default_factory=dict)
