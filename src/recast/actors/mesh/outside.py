"""What of a mesh can be seen from outside, and which side of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recast.actors.hull import require_volume, seen_from_outside
from recast.actors.mesh.sample import Samples

_CABIN_LIGHT = 0.3  # share of the daylight that falls on what stands behind glass
_BEHIND = 0.3  # cosine to the outer normal from which on a view is one of the inner side


@dataclass(frozen=True)
class Outside:
    """The visible surface of a vehicle.

    Attributes:
        samples: with normals towards where they are seen from.
        closed: (N,) whether the sample is opaque and has the vehicle's inside behind it: no view
            from outside shows its back, as of a mirror or a spoiler.
    """

    samples: Samples
    closed: NDArray[np.bool_]


def outside(samples: Samples) -> Outside:
    """What can be seen from outside, directly or through glass.

    Files wind their triangles either way, and hold engines and the insides of doors; light must
    fall on the outer side. What only glass shows gets less of it. All normals of glass point to
    one half of space, so that the two faces of a pane become one layer.

    Raises:
        ValueError: what is opaque has no volume, see `hull.require_volume`.
    """
    opaque = samples.alpha >= 1
    require_volume(samples.points[opaque])
    directions, seen = seen_from_outside(samples.points[opaque])
    direct = seen
    if not opaque.all():
        direct = seen_from_outside(samples.points)[1][:, opaque]
    kept = ~opaque
    kept[opaque] = seen.any(axis=0)
    towards = np.eye(3)[np.argmax(np.abs(samples.normals), axis=1)]
    towards[opaque] = -(seen.T.astype(np.float64) @ directions)
    inward = np.sum(towards * samples.normals, axis=1) < 0
    normals = np.where(inward[:, None], -samples.normals, samples.normals)
    light = np.ones(len(samples))
    light[opaque] = np.where(direct.any(axis=0), 1.0, _CABIN_LIGHT)
    closed = opaque.copy()
    from_behind = directions @ normals[opaque].T > _BEHIND
    closed[opaque] = direct.any(axis=0) & ~(direct & from_behind).any(axis=0)
    shown = replace(samples, normals=normals, albedo=samples.albedo * light[:, None])
    return Outside(shown.select(kept), closed[kept])
