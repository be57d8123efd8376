from __future__ import annotations

import numpy as np
import torch

from recast.cameras import PinholeCamera
from recast.reconstruction.tables import Exposures
from recast.reconstruction.views import TrainingView
from recast.scene.actor import exposed, exposed_colours
from recast.splats import rasterize
from support.gaussian_clouds import K, part

AFFINE = torch.tensor([[1.1, 0.05, 0.0, 0.02], [0.0, 0.9, 0.03, 0.01], [0.02, 0.0, 1.05, 0.03]])


def view(frame: int) -> TrainingView:
    image = np.zeros((4, 6, 3), np.uint8)
    camera = PinholeCamera(6, 4, 5.0, 5.0, 3.0, 2.0)
    return TrainingView("front", frame, frame * 100_000, camera, np.eye(4), image, None, False)


def test_views_start_unchanged_and_learn_apart() -> None:
    exposures = Exposures([view(0), view(1)])
    image = torch.rand(4, 6, 3, generator=torch.Generator().manual_seed(0))
    assert torch.equal(exposures.applied(image, view(1))[0], image)
    target = exposed_colours(image, AFFINE)
    for step in range(400):
        shown, _ = exposures.applied(image, view(1))
        (shown - target).square().sum().backward()
        exposures.table.step(0.01 * 0.99**step)
    learned = torch.eye(3, 4) + exposures.table.value[1].detach().view(3, 4)
    assert (learned - AFFINE).abs().max() < 0.01
    assert (exposures.table.value[0] == 0).all()
    halfway = torch.eye(3, 4) + (learned - torch.eye(3, 4)) / 2
    assert torch.allclose(exposures.mean(), halfway, atol=1e-6)


def test_the_regulariser_pulls_to_no_change() -> None:
    exposures = Exposures([view(0)])
    with torch.no_grad():
        exposures.table.value += 0.2
    shown, size = exposures.applied(torch.zeros(4, 6, 3), view(0))
    assert torch.allclose(size, torch.tensor(0.2)) and torch.allclose(shown, torch.tensor(0.2))
    size.backward()
    assert exposures.table.value.grad is not None and (exposures.table.value.grad > 0).all()


def test_written_into_the_colours_it_draws_the_same_picture() -> None:
    gaussians = part(40, 0)
    gaussians.sh[:, 1:] *= 0.2  # far from the clamp at zero
    gaussians.sh[:, 0] = gaussians.sh[:, 0].abs()
    plain = rasterize(gaussians, torch.eye(4), K, 48, 32)
    changed = rasterize(exposed(gaussians, AFFINE), torch.eye(4), K, 48, 32)
    expected = plain.rgb @ AFFINE[:, :3].T + plain.alpha[..., None] * AFFINE[:, 3]
    assert torch.allclose(changed.rgb, expected, atol=1e-5)


def test_between_knots_the_change_is_interpolated_and_parts_multiply() -> None:
    exposures = Exposures([view(frame) for frame in range(7)], apart_s=0.3)  # knots at 0, 3, 6
    with torch.no_grad():
        exposures.table.value[0, 0], exposures.table.value[1, 0] = -0.3, 0.3
        exposures.table.value[2, 3] = 0.1
    image = torch.full((4, 6, 3), 0.5)
    shown = [exposures.applied(image, view(frame))[0].detach() for frame in range(7)]
    reds = [float(one[0, 0, 0]) for one in shown]
    third = 0.05 / 3  # of what the last knot differs from the one before
    expected = [0.35, 0.45, 0.55, 0.65, 0.65 - third, 0.65 - 2 * third, 0.6]
    assert np.allclose(reds, expected)
    times, left = exposures.learned()["front"]
    assert times.tolist() == [0, 300_000, 600_000]
    mean = exposed_colours(image, exposures.mean())
    for frame in (0, 3, 6):  # what is left, after the mean, is the whole change
        row = torch.from_numpy(left[frame // 3]).float()
        assert torch.allclose(exposed_colours(mean, row), shown[frame], atol=1e-6)
