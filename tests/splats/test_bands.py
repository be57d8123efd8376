"""Images whose lists of tiles are too long to be held at once, and Gaussians beyond all sizes."""

from __future__ import annotations

import pytest
import torch

from recast.splats import Gaussians, rasterize
from recast.splats.native import rasterizer
from recast.splats.native.rasterizer import Workspace, free_memory
from recast.splats.rasterization import RasterMeta, check_settings
from support.splat_scenes import HEIGHT, WIDTH, K, camera, random_gaussians, render_with_gradients

ROUNDING = 1e-5
"""Of sums of some thousand terms in float32, added in another order, relative to the largest."""


@pytest.mark.parametrize("most", [1, 300, 2000])
@pytest.mark.parametrize("kind", ["normal", "opaque", "needles"])
def test_bands_change_no_pixel(
    isa: str, monkeypatch: pytest.MonkeyPatch, kind: str, most: int
) -> None:
    """Down to one row of tiles a band; gradients are sums of the same terms."""
    gaussians = random_gaussians(kind)
    gaussians.log_scales[::7] += 2.0  # some of more than 4x4 tiles
    options: dict[str, object] = {"background": torch.tensor([0.2, 0.5, 0.9]), "absgrad": True}
    whole = render_with_gradients(gaussians, "native", torch.float32, **options)
    monkeypatch.setattr(rasterizer, "MOST_AT_ONCE", most)
    banded = render_with_gradients(gaussians, "native", torch.float32, **options)
    for name in ("rgb", "depth", "alpha"):
        assert torch.equal(getattr(banded.image, name), getattr(whole.image, name)), name
    assert torch.equal(banded.image.meta.visible, whole.image.meta.visible)
    found = banded.gradients | {"absolute": banded.image.meta.means2d_absgrad}
    for name, wanted in (whole.gradients | {"absolute": whole.image.meta.means2d_absgrad}).items():
        assert float((found[name] - wanted).abs().max()) <= ROUNDING * float(wanted.abs().max())


@pytest.mark.usefixtures("compiled")
def test_the_memory_of_lists_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """3000 Gaussians that each fill 640x480: 3.6 million pairs, of which 100,000 are held."""
    most, width, height, count = 100_000, 640, 480, 3000
    generator = torch.Generator().manual_seed(0)
    gaussians = random_gaussians("normal", count, degree=0)
    means = torch.randn(count, 3, generator=generator) * 0.3 + torch.tensor([0.0, 0, 8])
    filling = [
        means,
        gaussians.quats,
        torch.full((count, 3), 3.0),
        torch.full((count,), -5.0),
        gaussians.sh,
    ]
    monkeypatch.setattr(rasterizer, "MOST_AT_ONCE", most)
    settings = check_settings(
        torch.eye(4),
        torch.tensor([[400.0, 0, 320], [0, 400, 240], [0, 0, 1]]),
        None,
        width=width,
        height=height,
        near=0.2,
        far=1e10,
        eps2d=0.3,
        antialiased=False,
        max_alpha=0.99,
    )
    meta = RasterMeta(
        torch.empty(count, dtype=torch.bool), torch.empty(count), torch.empty(count, 2)
    )
    free_memory()  # of larger views before
    workspace = Workspace()
    rasterizer.run_forward(workspace, tuple(filling), torch.eye(4), None, settings, meta, True)
    tiles = (width // 16) * (height // 16)
    assert workspace.intersections() == count * tiles
    states, rows = tiles * 5 * 256 * 4, count * 256
    assert workspace.nbytes() < 8 * most + 1.5 * (states + rows) + 2**20
    assert 8 * count * tiles > 2 * workspace.nbytes(), "the whole lists would be larger"


@pytest.mark.parametrize("backend", ["native", "reference"])
@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize(
    ("focal", "near", "log_scale"),
    [
        (1e29, 0.2, 0.0),
        (1e20, 0.2, -20.0),
        (70.0, 1e-20, 0.0),
        (1e5, 1e-6, 13.9),
        (1e-6, 0.2, 13.9),
    ],
)
@pytest.mark.usefixtures("compiled")
def test_gradients_are_finite_whatever_the_sizes(
    focal: float, near: float, log_scale: float, antialiased: bool, backend: str
) -> None:
    """Off the axis, and with areas in the image far beyond what float32 holds."""
    gaussians = random_gaussians("normal", count=60, degree=1)
    gaussians.means[:, 2] = torch.logspace(-20, 1, 60)
    leaves = Gaussians(
        gaussians.means.requires_grad_(),
        gaussians.quats.requires_grad_(),
        (gaussians.log_scales.clamp(-1, 0) + log_scale).requires_grad_(),
        gaussians.logit_opacities.requires_grad_(),
        gaussians.sh.requires_grad_(),
    )
    matrix = torch.tensor([[focal, 0, 44], [0, focal, 31], [0, 0, 1]], dtype=torch.float64)
    pose = camera().float().requires_grad_()
    image = rasterize(
        leaves, pose, matrix, 32, 24, near=near, antialiased=antialiased, backend=backend
    )
    assert all(bool(part.isfinite().all()) for part in (image.rgb, image.depth, image.alpha))
    (image.rgb.sum() + image.depth.sum() + image.alpha.sum()).backward()
    for name, value in (*vars(leaves).items(), ("pose", pose)):
        assert value.grad is None or bool(value.grad.isfinite().all()), name


@pytest.mark.usefixtures("compiled")
def test_both_leave_out_the_same_giants() -> None:
    """From a hundred to 1e12 pixels wide, some with determinants beyond the limit."""
    gaussians = random_gaussians("normal", count=40)
    gaussians.log_scales[:] = torch.linspace(2, 13.9, 40)[:, None]
    gaussians.means[:, 2] = 4
    fast = rasterize(
        gaussians, camera(), K * torch.tensor([[1e3], [1e3], [1]]), WIDTH, HEIGHT, backend="native"
    )
    slow = rasterize(
        gaussians,
        camera(),
        K * torch.tensor([[1e3], [1e3], [1]]),
        WIDTH,
        HEIGHT,
        backend="reference",
    )
    assert torch.equal(fast.meta.visible, slow.meta.visible)
    assert 0 < int(fast.meta.visible.sum()) < 40
    assert float((fast.rgb - slow.rgb).abs().max()) < 3e-3  # one grey level: alpha's threshold


@pytest.mark.parametrize("value", [1e38, 1e300, 1e-38])
def test_cameras_beyond_float32_are_none(value: float) -> None:
    gaussians = random_gaussians("normal", count=5)
    matrix = torch.tensor([[value, 0, 44], [0, 70, 31], [0, 0, 1]], dtype=torch.float64)
    with pytest.raises(ValueError, match="make no camera"):
        rasterize(gaussians, camera(), matrix, WIDTH, HEIGHT)
