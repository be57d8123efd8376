"""All frames that may show a track, from which the best ones are taken, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from recast.actors.observation import ViewScore
from recast.actors.view_score import NearestSweeps, check_lidar, score_frame
from recast.errors import InputError
from recast.logs import DrivingLog, Track

Usable = Callable[[str, int], bool]
"""Whether a frame may be looked at, by camera name and index; held-out frames may not."""

LEAST_TURN = np.radians(15.0)
"""Angle between the azimuths of two views of one track, at least."""
_FULL_TURN = np.radians(90.0)  # a view turned that much shows another side
_LEAST_SHARE = 0.2  # of the best view's detail: smaller or more hidden ones tell too little
_LEAST_GAIN = 0.1  # of the best view's detail
_LEAST_IN_IMAGE = 1 / 3  # of the box: of less, neither the place nor the mask can be told
_MIN_CHECKED = 4


class ViewPool:
    """The frames in which a track is in view, with their scores.

    LiDAR occlusion can only lower a score. So it is checked from the top of a list down, until no
    frame left could win.

    Args:
        cameras: consider only these camera streams; all if none is named.
        usable: consider only these frames; all if None.

    Raises:
        InputError: the log has no such camera.
    """

    def __init__(
        self,
        log: DrivingLog,
        track: Track,
        cameras: Sequence[str] = (),
        usable: Usable | None = None,
    ) -> None:
        for camera in cameras:
            if camera not in log.cameras:
                names = ", ".join(log.cameras)
                raise InputError(
                    log.name, f"camera {camera}", "is not in the log", f"choose from {names}"
                )
        self._log, self._track, self._sweeps = log, track, NearestSweeps(log)
        self._checked: dict[tuple[str, int], ViewScore] = {}
        self._bounds = [
            score
            for name, stream in log.cameras.items()
            if not cameras or name in cameras
            for frame in range(len(stream.timestamps_us))
            if (usable is None or usable(name, frame))
            and (score := score_frame(log, track, stream, frame)) is not None
        ]

    def ranked(self) -> list[ViewScore]:
        """The best frames, best first, at least four if there are so many; ties: earlier first."""
        return self._best(lambda view: view.score, _MIN_CHECKED)

    def next_best(
        self, taken: Sequence[ViewScore], left_out: Sequence[ViewScore]
    ) -> ViewScore | None:
        """The frame that adds most to those taken: by its detail times the turn to the nearest one.

        The turn counts in full from 90 degrees of azimuth on, and not at all below `LEAST_TURN`.
        None if no frame is left that adds a tenth of what the first view tells.

        Args:
            taken: views so far, best first; at least one.
            left_out: views that turned out to be unusable.
        """
        first = taken[0].detail
        refused = {view.key for view in left_out}

        def gain(view: ViewScore) -> float:
            turn = min(_turn(view, other) for other in taken)
            adds = view.detail * min(turn / _FULL_TURN, 1.0)
            enough = turn >= LEAST_TURN and adds >= _LEAST_GAIN * first
            whole = view.in_image >= _LEAST_IN_IMAGE and view.detail >= _LEAST_SHARE * first
            return adds if enough and whole and view.key not in refused else 0.0

        best = self._best(gain, 1)
        return best[0] if best else None

    def _best(self, value: Callable[[ViewScore], float], count: int) -> list[ViewScore]:
        """The frames checked on the way to the most valuable one, that first."""
        checked: list[tuple[float, ViewScore]] = []
        bounds = [(value(bound), bound) for bound in self._bounds]
        for limit, bound in sorted(bounds, key=lambda one: -one[0]):
            best = max((found for found, _ in checked), default=0.0)
            if limit <= 0 or (len(checked) >= count and best >= limit):
                break
            score = self._check(bound)
            if (found := value(score)) > 0:
                checked.append((found, score))
        return [score for _, score in sorted(checked, key=lambda one: -one[0])]

    def _check(self, bound: ViewScore) -> ViewScore:
        if bound.key not in self._checked:
            self._checked[bound.key] = check_lidar(self._log, self._track, bound, self._sweeps)
        return self._checked[bound.key]


def _turn(first: ViewScore, second: ViewScore) -> float:
    """Angle between the azimuths of two views, radians in [0, pi]."""
    apart = first.azimuth - second.azimuth
    return float(abs(np.arctan2(np.sin(apart), np.cos(apart))))
