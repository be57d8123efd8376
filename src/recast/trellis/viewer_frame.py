"""The axis transform of the published PLY export."""

from __future__ import annotations

import torch

from recast.splats import Gaussians

_VIEWER_FROM_NATIVE = torch.tensor(
    [[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]]
)


def viewer_frame(gaussians: Gaussians) -> Gaussians:
    """Turn native Gaussians (z up) into the frame of the usual splat viewers (-y up).

    (x, y, z) becomes (x, -z, y), the default of the published exporter. recast itself works in the
    native frame; its inverse is (x, y, z) = (x', z', -y').
    """
    return gaussians.transformed(_VIEWER_FROM_NATIVE)
