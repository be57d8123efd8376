"""Putting things beside the road, where there is room for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from recast.geometry import se3
from recast.synthetic.streets.ground import Ground
from recast.synthetic.streets.reference_line import Pose
from recast.synthetic.surface import Surface

Array = NDArray[np.float64]

HEADROOM = 4.5
"""Metres above the lanes that stay free."""
_VAN_HEIGHT = 2.6
"""Metres above all other asphalt that stay free."""
_KERB_CLEARANCE = 0.12
_OVERLAP = 0.12
"""Share of the smaller of two outlines by which they may overlap, seen from above."""


@dataclass(frozen=True)
class Prop:
    """A thing that may stand somewhere, with its outlines seen from above in its own frame.

    Attributes:
        surface: as the scenery functions give it.
        foot: hull of what reaches below the height of a van.
        low: hull of what reaches below the headroom.
        whole: hull of all.
    """

    surface: Surface
    foot: shapely.Geometry
    low: shapely.Geometry
    whole: shapely.Geometry

    @classmethod
    def of(cls, surface: Surface) -> Prop:
        """A prop from its triangles."""
        lowest = surface.vertices[surface.faces, 2].min(axis=1)
        foot, low = (
            _hull(surface.vertices[surface.faces[lowest < height].ravel(), :2])
            for height in (_VAN_HEIGHT, HEADROOM)
        )
        return cls(surface, foot, low, _hull(surface.vertices[:, :2]))


def _hull(points: Array) -> shapely.Geometry:
    # One chain of points: to make many points of their own takes ten times as long.
    return shapely.convex_hull(shapely.linestrings(points))


class Placer:
    """Places props one after the other, each clear of the road and of those before.

    Attributes:
        placed: the surfaces, in the world frame.
    """

    def __init__(self, ground: Ground, lanes: shapely.Geometry) -> None:
        self.placed: list[Surface] = []
        self._ground = ground
        self._road = ground.asphalt.buffer(_KERB_CLEARANCE)
        self._lanes = lanes.buffer(0.05)
        shapely.prepare(self._road)
        shapely.prepare(self._lanes)
        self._outlines: list[shapely.Geometry] = []
        self._bounds: list[tuple[float, float, float, float]] = []

    def reserve(self, outline: shapely.Geometry) -> None:
        """Keep an area free of whatever comes later."""
        self._outlines.append(outline)
        self._bounds.append(outline.bounds)

    def place(
        self,
        prop: Prop,
        pose: Pose,
        keep_off: shapely.Geometry | None = None,
        overlap: float = _OVERLAP,
        lift: float = 0.0,
    ) -> bool:
        """Put a prop on the ground at a pose; False where there is no room.

        Args:
            prop: what to place.
            pose: of its origin.
            keep_off: an area, besides the road, that it must not touch; prepared, for speed.
            overlap: share of the smaller of two outlines by which they may overlap.
            lift: metres above the ground at which it stands.
        """
        foot, low, whole = (_moved(part, pose) for part in (prop.foot, prop.low, prop.whole))
        if self._road.intersects(foot) or self._lanes.intersects(low):
            return False
        if keep_off is not None and keep_off.intersects(foot):
            return False
        if self._collides(whole, overlap):
            return False
        self.reserve(whole)
        z = lift + float(self._ground.height(np.array([[pose.x, pose.y]]))[0])
        world_from_prop = se3.from_rotation_translation(
            se3.rotation_z(pose.heading), np.array([pose.x, pose.y, z])
        )
        self.placed.append(prop.surface.transformed(world_from_prop))
        return True

    def _collides(self, outline: shapely.Geometry, overlap: float) -> bool:
        if not self._bounds:
            return False
        low_x, low_y, high_x, high_y = outline.bounds
        box = np.array(self._bounds)
        near = (box[:, 0] < high_x) & (box[:, 2] > low_x)
        near &= (box[:, 1] < high_y) & (box[:, 3] > low_y)
        for index in np.flatnonzero(near):
            other = self._outlines[index]
            least = min(outline.area, other.area)
            if outline.intersection(other).area > overlap * least:
                return True
        return False


def _moved(outline: shapely.Geometry, pose: Pose) -> shapely.Geometry:
    c, s = np.cos(pose.heading), np.sin(pose.heading)
    turn = np.array([[c, -s], [s, c]])
    return shapely.transform(outline, lambda xy: xy @ turn.T + np.array([pose.x, pose.y]))
