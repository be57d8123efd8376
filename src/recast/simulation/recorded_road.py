"""The recorded road: nothing is simulated beside it, and it lifts planar poses into space."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import shapely
from numpy.typing import NDArray

from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs.hdmap import GroundHeight
from recast.logs.types import Trajectory
from recast.planning import ReferenceRoute
from recast.simulation.setup import RolloutSetup

_MIN_CYCLES = 2
_BEHIND_START = 1.0
"""Metres that a position may lie before the route: a standing ego may roll back a little."""
_BESIDE_LOGGED = 2.0
"""Metres from its own logged path within which an actor that follows it is on recorded road."""
_SLOPE_SPAN = 5.0
"""Metres before and behind a point over which the road's slope is measured."""
SMOOTHING = 5
"""Steps before and behind over which an actor's height is averaged: grids have cell edges."""


class Ending(StrEnum):
    """What ends a rollout."""

    STEPS = "steps"  # all that were asked for
    LOG = "log"  # the log ends
    ACTOR = "actor"  # a controlled actor came to the end of the recorded road
    EGO = "ego"  # the ego came to the end of its route
    EGO_BEFORE = "ego-before"  # the ego went back to before the beginning of its route
    CONTACT = "contact"  # see `RolloutSettings.end_on_contact`


@dataclass(frozen=True)
class RecordedRoad:
    """Where one road user may be.

    Attributes:
        route: the ego's reference route.
        margin: metres before its end that are left free.
        own: (N, 2) the road user's own logged path if it follows that, which counts as well; else
            None.
    """

    route: ReferenceRoute
    margin: float
    own: Array | None = None

    def outside(self, points: Array, s: Array | None = None) -> NDArray[np.bool_]:
        """Which points (..., 2) lie before the recorded road, or beyond its end less `margin`.

        Args:
            s: coordinates (...) on the route, where they are known; else the nearest place counts.
        """
        s = self.route.project(points)[0] if s is None else s
        outside: NDArray[np.bool_] = (s < -_BEHIND_START) | (s > self.route.length - self.margin)
        if self.own is not None and outside.any():
            outside = outside & (self._beside(points) > _BESIDE_LOGGED)
        return outside

    def ending(self, s: float) -> Ending:
        """How the rollout ends if the ego comes to the coordinate `s` outside of the road."""
        return Ending.EGO_BEFORE if s < 0 else Ending.EGO

    def reason(self, who: str, point: Array, s: float | None = None) -> str:
        """Why a rollout is cut where `who` would come to `point` (2,); `s` as for `outside`."""
        if self.own is not None:
            metres = float(self._beside(point))
            return (
                f"{who} would leave the recorded road: it would be {metres:.1f} m from its "
                "logged path"
            )
        s = float(self.route.project(point)[0]) if s is None else s
        if s < 0:
            return f"{who} would leave the recorded road {-s:.1f} m before its start"
        return (
            f"{who} would leave the recorded road: it would be at {s:.1f} m of "
            f"{self.route.length:.1f} m, closer than {self.margin:g} m to its end"
        )

    def _beside(self, points: Array) -> Array:
        """Metres (...) from points (..., 2) to the own path."""
        assert self.own is not None
        path = shapely.points(self.own[0]) if len(self.own) == 1 else shapely.linestrings(self.own)
        return shapely.distance(path, shapely.points(points))


def who(setup: RolloutSetup, track_id: str) -> str:
    """A controlled actor as reasons and errors call it."""
    return "the actor" if track_id == setup.track_id else f"actor {track_id}"


def refuse_if_too_short(setup: RolloutSetup, steps: int, reason: str | None) -> None:
    """Refuse a rollout of which a cut leaves less than two plan cycles.

    Raises:
        InputError: names the reason of the cut.
    """
    needed = min(_MIN_CYCLES * setup.plan_every, setup.steps)
    if steps < needed:
        raise InputError(
            setup.log.name,
            f"rollout {setup.name}",
            f"{reason}, which leaves {max(steps, 0)} of {setup.steps} steps, "
            f"but at least {needed} are needed",
            "choose an earlier start, another motion or setting, or a longer log",
        )


@dataclass(frozen=True)
class RoadSurface:
    """The road under the logged path, and the ground beside it where the map knows it.

    Attributes:
        route: gives the coordinate s of everything here.
        s: (T,) increasing route coordinates of logged poses.
        z, pitch, roll: (T,) height, pitch and roll of the logged rig there; the rig's origin lies
            on the ground.
        ground: grid of ground heights, or None.
    """

    route: ReferenceRoute
    s: Array
    z: Array
    pitch: Array
    roll: Array
    ground: GroundHeight | None = None

    @classmethod
    def from_log(
        cls, log: Trajectory, route: ReferenceRoute, ground: GroundHeight | None
    ) -> RoadSurface:
        """Read heights and tilts off the logged ego poses."""
        s, _ = route.project(log.poses[:, :2, 3], route.at_time(log.timestamps_us))
        # Standing still adds poses but no road; keep those that lie further on than all before.
        reached = np.maximum.accumulate(np.concatenate([[-np.inf], s[:-1]]))
        ahead = s > reached + 1e-3
        pose = log.poses[ahead]
        return cls(
            route=route,
            s=s[ahead],
            z=pose[:, 2, 3],
            pitch=-np.arcsin(np.clip(pose[:, 2, 0], -1.0, 1.0)),
            roll=np.arctan2(pose[:, 2, 1], pose[:, 2, 2]),
            ground=ground,
        )

    def ego_poses(self, poses: Array) -> Array:
        """`world_from_rig` (..., 4, 4) of planar rear-axle poses (..., 3).

        Height, pitch and roll are the logged ones at the nearest place of the route.
        """
        s, _ = self.route.project(poses)
        z, pitch, roll = (
            np.interp(s, self.s, values) for values in (self.z, self.pitch, self.roll)
        )
        cp, sp, cr, sr = np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
        zero = np.zeros_like(cp)
        tilt = np.stack(
            [
                np.stack([cp, sp * sr, sp * cr], axis=-1),
                np.stack([zero, cr, -sr], axis=-1),
                np.stack([-sp, cp * sr, cp * cr], axis=-1),
            ],
            axis=-2,
        )
        rotation = se3.rotation_z(poses[..., 2]) @ tilt
        xyz = np.concatenate([poses[..., :2], z[..., None]], axis=-1)
        return se3.from_rotation_translation(rotation, xyz)

    def actor_poses(self, poses: Array, size: Array) -> Array:
        """`world_from_actor` (T, 4, 4) of planar box-centre poses (T, 3) in the order of time.

        The box stands on the ground: the mean height of the ground grid under its footprint, or of
        the logged road where the grid knows less than half of that. It tilts with the slope of the
        logged road, not with the ego's springs.
        """
        s, _ = self.route.project(poses)
        z = np.interp(s, self.s, self.z)
        if self.ground is not None:
            known = self._ground_under(poses, size)
            z = np.where(np.isnan(known), z, known)
            padded = np.pad(z, SMOOTHING, mode="edge")
            z = np.convolve(padded, np.full(2 * SMOOTHING + 1, 1 / (2 * SMOOTHING + 1)), "valid")
        behind, ahead = np.clip([s - _SLOPE_SPAN, s + _SLOPE_SPAN], self.s[0], self.s[-1])
        rise = np.interp(ahead, self.s, self.z) - np.interp(behind, self.s, self.z)
        slope = rise / np.maximum(ahead - behind, 1e-6)
        along = self.route.heading(s)
        up = np.stack([-slope * np.cos(along), -slope * np.sin(along), np.ones_like(s)], axis=-1)
        up /= np.linalg.norm(up, axis=-1, keepdims=True)
        heading = poses[:, 2]
        climb = slope * np.cos(heading - along)
        forward = np.stack([np.cos(heading), np.sin(heading), climb], axis=-1)
        forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
        rotation = np.stack([forward, np.cross(up, forward), up], axis=-1)
        bottom = np.concatenate([poses[:, :2], z[:, None]], axis=-1)
        return se3.from_rotation_translation(rotation, bottom + up * size[2] / 2)

    def _ground_under(self, poses: Array, size: Array) -> Array:
        """Mean ground height (T,) under footprints; NaN where less than half is known."""
        assert self.ground is not None
        x, y = np.meshgrid(np.linspace(-0.5, 0.5, 7) * size[0], np.linspace(-0.5, 0.5, 5) * size[1])
        cos, sin = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
        points = np.stack(
            [
                poses[:, 0, None] + cos * x.ravel() - sin * y.ravel(),
                poses[:, 1, None] + sin * x.ravel() + cos * y.ravel(),
            ],
            axis=-1,
        )
        heights = self.ground.at(points)
        known = ~np.isnan(heights)
        count = known.sum(axis=1)
        mean = np.where(known, heights, 0.0).sum(axis=1) / np.maximum(count, 1)
        return np.where(2 * count >= heights.shape[1], mean, np.nan)
