"""The target vehicle: driven so that the log sees it from some sides only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from recast.logs import HdMap
from recast.synthetic.ego import CENTRE_OFFSET, EgoDrive
from recast.synthetic.lane_path import LanePath
from recast.synthetic.routes import beside

Array = NDArray[np.float64]

Manner = Literal["leading", "overtaking", "passed"]
"""Ahead in the ego's lane, or in the next lane: falling ahead, or falling behind."""

MANNERS: Mapping[str, Manner] = {
    "urban-straight": "overtaking",
    "arterial-median": "passed",
    "underpass": "overtaking",
}
"""By scene; "leading" where not named, and where no lane lies beside."""

TARGET_KINDS = ("hatchback", "sedan", "estate", "suv")

_NEAR, _FAR = 6.5, 27.0
"""Metres along the road from the rig to the target's middle in the next lane."""
_RELATIVE_SPEED = 2.6
_LEAD, _LEAD_NEAREST = 15.0, 10.5
"""The same in the ego's own lane: on average, and never less."""
_LEAD_WAVE = 0.06
_WHEELBASE_SHARE = 0.58


@dataclass(frozen=True)
class TargetDrive:
    """How the target drives.

    Attributes:
        manner: what was possible, see `Manner`.
        path: of its middle.
        place: (T,) metres along it.
    """

    manner: Manner
    path: LanePath
    place: Array

    def poses(self, length: float) -> Array:
        """(T, 3) planar poses of the middle of a vehicle of this length."""
        return self.path.poses(self.place, wheelbase(length))


def wheelbase(length: float) -> float:
    """Metres between the axles of a vehicle of some length."""
    return _WHEELBASE_SHARE * length


def target_drive(
    street_map: HdMap, ego: EgoDrive, manner: Manner, rng: np.random.Generator
) -> TargetDrive:
    """The target's drive: the ego's own, some seconds ahead.

    It passes every place at about the speed of the ego there, so it slows down for the same bends.
    The lead in seconds changes with time.
    """
    for side in ("left", "right") if manner != "leading" else ():
        lanes = beside(street_map, ego.path.lanes, side)
        if lanes is None:
            continue
        path = LanePath.along(street_map, lanes)
        place = _in_next_lane(path, ego, manner)
        if place is not None:
            return TargetDrive(manner, path, place)
    return TargetDrive("leading", ego.path, _leading(ego, rng))


def _leading(ego: EgoDrive, rng: np.random.Generator) -> Array:
    """At the shortest lead that never comes too near, but on average not below the usual."""
    wave = np.sin(2 * np.pi * (ego.seconds / rng.uniform(9.0, 14.0) + rng.uniform()))
    lead = _LEAD / ego.mean_speed
    while True:
        place = ego.place(ego.seconds + lead * (1 + _LEAD_WAVE * wave))
        if (place - ego.place(ego.seconds)).min() >= _LEAD_NEAREST:
            return place
        lead += 0.05


def _in_next_lane(path: LanePath, ego: EgoDrive, manner: Manner) -> Array | None:
    """Places on the lane beside the ego's, or None where that lane is too short."""
    seconds = ego.seconds
    change = min(_FAR - _NEAR, _RELATIVE_SPEED * float(seconds[-1]))
    ahead = _NEAR + change * seconds / seconds[-1]
    if manner == "passed":
        ahead = ahead[::-1]
    lead = ahead / ego.mean_speed
    wanted = ego.place(seconds + lead)
    marks = np.arange(0.0, ego.path.length, 4.0)
    beside_marks, lateral = path.line.to_frenet(ego.path.position(marks))
    inside = (beside_marks > 0.1) & (beside_marks < path.length - 0.1) & (np.abs(lateral) < 8.0)
    marks, beside_marks = marks[inside], beside_marks[inside]
    if len(marks) < 2 or np.any(np.diff(beside_marks) <= 0):
        return None
    if wanted.min() < marks[0] + CENTRE_OFFSET or wanted.max() > marks[-1] - 5.0:
        return None
    place: Array = PchipInterpolator(marks, beside_marks)(wanted)
    return place
