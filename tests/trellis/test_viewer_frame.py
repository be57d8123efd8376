"""The two PLY frames against files of the published exporter."""

from __future__ import annotations

import torch

from recast.splats import Gaussians, read_ply
from recast.trellis.generate import viewer_frame
from support.trellis import FOLDER, assert_same


def _same_gaussians(found: Gaussians, expected: Gaussians) -> None:
    assert_same(found.means, expected.means)
    assert_same(found.log_scales, expected.log_scales)
    assert_same(found.logit_opacities, expected.logit_opacities)
    assert_same(found.sh, expected.sh)
    unit = expected.quats / expected.quats.norm(dim=1, keepdim=True)
    mine = found.quats / found.quats.norm(dim=1, keepdim=True)
    assert_same((mine * unit).sum(dim=1).abs(), torch.ones(len(unit)))


def test_native_frame_becomes_the_viewers() -> None:
    native = read_ply(FOLDER / "gs_sub64_notransform.ply")
    expected = read_ply(FOLDER / "gs_sub64_default.ply")
    _same_gaussians(viewer_frame(native), expected)


def test_up_becomes_minus_y() -> None:
    top = Gaussians(
        torch.tensor([[0.1, 0.2, 0.4]]),
        torch.tensor([[1.0, 0, 0, 0]]),
        torch.zeros(1, 3),
        torch.zeros(1),
        torch.zeros(1, 1, 3),
    )
    torch.testing.assert_close(viewer_frame(top).means, torch.tensor([[0.1, -0.4, 0.2]]))
