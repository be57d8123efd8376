"""Filters of the pass: what each declares, and drawing what one was made for through another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from recast.core.errors import InputError
from recast.splats import (
    CLASSIC,
    MIP,
    Gaussians,
    LowPass,
    rasterize,
    read_ply,
    refiltered,
    write_ply,
)
from recast.splats.gaussians import LARGEST, LOG_SCALES
from recast.splats.ply import read_low_pass

FOCAL, SIDE = 200.0, 64
K = torch.tensor([[FOCAL, 0, SIDE / 2], [0, FOCAL, SIDE / 2], [0, 0, 1]])
EYE = torch.eye(4)
LEAST, MOST = LOG_SCALES[0] + 1e-5, LOG_SCALES[1] - 1e-5
FAR = 0.99 * LARGEST

filters = st.builds(LowPass, st.floats(0.0, 0.5), st.booleans())


def one(deviations: tuple[float, float, float], depth: float, opacity: float = 0.6) -> Gaussians:
    """One grey Gaussian ahead of the camera, turned about the view."""
    return Gaussians(
        torch.tensor([[0.0, 0.0, depth]]),
        torch.tensor([[0.9, 0.0, 0.0, 0.4]]),
        torch.tensor([deviations]).log(),
        torch.tensor([opacity]).logit(),
        torch.zeros(1, 1, 3),
    )


def alpha(gaussians: Gaussians, low_pass: LowPass) -> torch.Tensor:
    return rasterize(
        gaussians.to("cpu"),
        EYE,
        K,
        SIDE,
        SIDE,
        eps2d=low_pass.variance,
        antialiased=low_pass.antialiased,
        backend="reference",
    ).alpha


@given(filters, filters, st.floats(1.0, 4.0), st.floats(1.0, 4.0), st.floats(2.0, 20.0))
@settings(max_examples=60, deadline=None)
def test_what_is_larger_than_the_filters_looks_the_same(
    made_for: LowPass, drawn_by: LowPass, major: float, minor: float, depth: float
) -> None:
    """Deviations of one pixel and more, and thin along the view: equal but for rounding."""
    pixel = depth / FOCAL
    # compensation for the filters is at most 2: opacity 0.3 is nowhere clamped at 1
    gaussians = one((major * pixel, minor * pixel, 1.5 * pixel), depth, 0.3)
    wanted = alpha(gaussians, made_for)
    found = alpha(refiltered(gaussians, made_for, drawn_by, EYE, K), drawn_by)
    # alpha below 1/255 is not drawn: at that rim a pixel may be on one side or the other
    inner = (wanted > 0.01) | (found > 0.01)
    np.testing.assert_allclose(found[inner], wanted[inner], atol=1e-4)


@given(st.floats(0.02, 0.4), st.floats(0.02, 0.4), st.floats(0.05, 0.9))
@settings(max_examples=60, deadline=None)
def test_small_gaussians_keep_their_weight(major: float, minor: float, opacity: float) -> None:
    """Their integral over the image, which a classic pass makes up to hundreds of times larger."""
    depth = 10.0
    pixel = depth / FOCAL
    gaussians = one((major * pixel, minor * pixel, minor * pixel), depth, opacity)
    made = refiltered(gaussians, MIP, CLASSIC, EYE, K)
    weight = 2 * np.pi * major * minor * opacity  # of the Gaussian itself, px^2
    scales = made.log_scales.exp()[0] / pixel
    variances = [float(scales[axis]) ** 2 + CLASSIC.variance for axis in (0, 1)]
    found = 2 * np.pi * np.sqrt(np.prod(variances)) * float(made.logit_opacities.sigmoid())
    assert found == pytest.approx(weight, rel=1e-3)


def test_the_same_filter_changes_nothing() -> None:
    gaussians = one((0.1, 0.2, 0.1), 5.0)
    assert refiltered(gaussians, MIP, LowPass(0.1, antialiased=True), EYE, K) is gaussians
    none = gaussians.select(torch.zeros(0, dtype=torch.int64))
    assert len(refiltered(none, MIP, CLASSIC, EYE, K)) == 0


@given(
    st.sampled_from([LEAST, -20.0, 0.0, 5.0, MOST]),
    st.sampled_from([LEAST, -3.0, MOST]),
    st.sampled_from([-FAR, -30.0, 0.0, 30.0, FAR]),
    st.sampled_from([-5.0, 0.0, 1e-6, 3.0, FAR]),
    filters,
    filters,
)
@example(LEAST, LEAST, -FAR, 3.0, LowPass(0.5, antialiased=False), LowPass(0.5, antialiased=True))
@settings(max_examples=150, deadline=None)
def test_whatever_the_rasterizer_takes_stays_drawable(
    first: float, second: float, logit: float, depth: float, made_for: LowPass, drawn_by: LowPass
) -> None:
    gaussians = Gaussians(
        torch.tensor([[0.0, 1.0, depth]]),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        torch.tensor([[first, second, first]]),
        torch.tensor([logit]),
        torch.zeros(1, 1, 3),
    )
    refiltered(gaussians, made_for, drawn_by, EYE, K).validate()


def test_gradients_pass() -> None:
    gaussians = one((0.05, 0.02, 0.02), 6.0)
    scales = gaussians.log_scales.requires_grad_()
    alpha(refiltered(gaussians, MIP, CLASSIC, EYE, K), CLASSIC).sum().backward()
    assert scales.grad is not None and bool(torch.isfinite(scales.grad).all())
    assert float(scales.grad.abs().max()) > 0


@pytest.mark.parametrize("low_pass", [CLASSIC, MIP, LowPass(0.05, antialiased=True)])
def test_a_ply_declares_its_filter(tmp_path: Path, low_pass: LowPass) -> None:
    path = tmp_path / "car.ply"
    write_ply(path, one((0.1, 0.2, 0.1), 5.0), low_pass)
    assert read_low_pass(path) == low_pass
    assert len(read_ply(path)) == 1
    write_ply(path, one((0.1, 0.2, 0.1), 5.0))
    assert read_low_pass(path) is None


@pytest.mark.parametrize("text", ["", "nan", "-1", "0.1 smooth", "0.1 antialiased x", "1e999"])
def test_declarations_that_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "car.ply"
    write_ply(path, one((0.1, 0.2, 0.1), 5.0), MIP)
    data = path.read_bytes().replace(b"low_pass 0.1 antialiased", b"low_pass " + text.encode())
    path.write_bytes(data)
    with pytest.raises(InputError, match="cannot be understood"):
        read_low_pass(path)
    with pytest.raises(InputError, match=r"nowhere\.ply"):
        read_low_pass(tmp_path / "nowhere.ply")
