"""The image loss: compiled against plain torch in float64."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from recast.kernel import info, set_threads
from recast.reconstruction.losses import photometric_loss, photometric_reference

# Blurs of squares up to q are off by at most 14 roundings (products, and two sums of six terms); a
# variance is a difference of such blurs and counts over C2 at the least, which is 9e-4: so a
# derivative is off by no more than 2 * 14 * q / 9e-4 roundings, 2e-3 of itself at q = 1. That is
# where all of the image is flat; of noise, variances are a tenth of q, and the share is 1e-5.
TOLERANCE = 2 * 14 * 2.0**-24 / 0.1


@pytest.fixture
def threads() -> Iterator[None]:
    """Give the kernel its number of threads back."""
    before = info().threads
    yield
    if before:
        set_threads(before)


def pair(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    target = torch.rand(height, width, 3, generator=generator)
    image = target + 0.1 * torch.randn(target.shape, generator=generator)
    return image.clamp(0, 1), target


# One pixel; less than the window; a row of more than one stretch of the kernel; odd sizes.
@pytest.mark.parametrize("size", [(1, 1), (3, 2), (11, 4), (2, 161), (37, 52), (13, 401)])
@pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
@pytest.mark.usefixtures("isa")
def test_compiled_matches_reference(size: tuple[int, int], weight: float) -> None:
    image, target = pair(*size)
    plain = image.double().requires_grad_()
    expected = photometric_reference(plain, target.double(), weight)
    expected.backward()
    fused = image.clone().requires_grad_()
    loss = photometric_loss(fused, target, weight)
    (3 * loss).backward()
    assert loss.item() == pytest.approx(expected.item(), abs=1e-6)
    assert plain.grad is not None and fused.grad is not None
    assert ((fused.grad / 3 - plain.grad).abs() <= TOLERANCE * plain.grad.abs().max()).all()


@pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
def test_values_beyond_the_unit_range(isa: str, weight: float) -> None:
    image, target = pair(30, 40)
    image = 4 * image - 1  # what is rendered is not clamped
    plain = image.double().requires_grad_()
    photometric_reference(plain, target.double(), weight).backward()
    fused = image.clone().requires_grad_()
    photometric_loss(fused, target, weight).backward()
    assert plain.grad is not None and fused.grad is not None
    assert ((fused.grad - plain.grad).abs() <= TOLERANCE * plain.grad.abs().max()).all(), isa


@pytest.mark.usefixtures("compiled", "threads")
def test_nothing_hangs_on_threads() -> None:
    image, target = pair(37, 52)
    found = []
    for threads in (1, 2, 3):
        set_threads(threads)
        leaf = image.clone().requires_grad_()
        loss = photometric_loss(leaf, target)
        loss.backward()
        found.append((loss.detach(), leaf.grad))
    for loss, gradient in found[1:]:
        assert torch.equal(loss, found[0][0]) and torch.equal(gradient, found[0][1])


def test_images_that_are_views_of_others() -> None:
    image, target = pair(24, 40)
    whole, part = image.clone().requires_grad_(), image[4:20, 8:30].clone().requires_grad_()
    photometric_loss(whole[4:20, 8:30], target[4:20, 8:30]).backward()
    photometric_loss(part, target[4:20, 8:30].contiguous()).backward()
    assert whole.grad is not None and torch.equal(whole.grad[4:20, 8:30], part.grad)


@pytest.mark.parametrize("shape", [(4, 5, 4), (4, 6, 3), (20,)])
def test_shapes_are_checked(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected one shape"):
        photometric_loss(torch.zeros(4, 5, 3), torch.zeros(shape))
