"""Files with the images that count: those of a scene's rollouts, and the logged ones."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, NonNegativeInt

from recast.evaluation.oracle_scores import Rectangle
from recast.evaluation.scene_level.frames import LoggedFrame, RolloutFrame
from recast.records import Record, read_record

FRAMES_FILE, REFERENCES_FILE = "frames.json", "references.json"
_VERSION: Literal[1] = 1
_MEND = "remove the artefact that holds it, and run again"


class FramesRecord(Record):
    """frames.json.

    Attributes:
        frames: in the order of motions, steps and cameras.
        shown: indices of the frames that stand in the figure.
        failures: motion with its setting to the reason why it was not driven.
    """

    version: Literal[1] = _VERSION
    frames: tuple[RolloutFrame, ...]
    shown: tuple[NonNegativeInt, ...]
    failures: dict[str, str] = Field(default_factory=dict)


class ReferencesRecord(Record):
    """references.json.

    Attributes:
        frames: logged images that count.
        compared: indices of those whose crops LPIPS and the CLIP image score compare with.
    """

    version: Literal[1] = _VERSION
    frames: tuple[LoggedFrame, ...]
    compared: tuple[NonNegativeInt, ...]


def read_frames(folder: Path) -> FramesRecord:
    """Read frames.json; InputError if it is missing or damaged."""
    return read_record(folder / FRAMES_FILE, FramesRecord, _VERSION, _MEND)


def read_references(folder: Path) -> ReferencesRecord:
    """Read references.json; InputError if it is missing or damaged."""
    return read_record(folder / REFERENCES_FILE, ReferencesRecord, _VERSION, _MEND)


def shown_frames(frames: tuple[RolloutFrame, ...]) -> tuple[int, ...]:
    """For each motion and setting, the frame with the largest rectangle, the first of equals."""
    best: dict[tuple[str, str], int] = {}
    for index, frame in enumerate(frames):
        key = (frame.motion, frame.setting)
        if key not in best or _area(frame.rectangle) > _area(frames[best[key]].rectangle):
            best[key] = index
    return tuple(sorted(best.values()))


def _area(rectangle: Rectangle) -> int:
    left, top, right, bottom = rectangle
    return (right - left) * (bottom - top)
