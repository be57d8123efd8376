"""gsplat behind `rasterize`: the translation against a stand-in, and on a GPU the real thing."""

from __future__ import annotations

import gc
import sys
import weakref
from dataclasses import replace
from importlib.util import find_spec
from types import ModuleType

import pytest
import torch

from recast.core.errors import InputError
from recast.splats import Gaussians, cuda, pick_device, rasterize
from support.splat_scenes import (
    HEIGHT,
    KINDS,
    WIDTH,
    K,
    Outcome,
    camera,
    random_gaussians,
    relative_error,
    render_with_gradients,
)
from support.stand_in_gsplat import install

RASTERIZE = sys.modules["recast.splats.rasterize"]  # the function hides its module
OPTIONS: dict[str, dict[str, object]] = {
    "classic": {},
    "background": {"background": torch.tensor([0.2, 0.5, 0.9])},
    "antialiased": {"antialiased": True, "eps2d": 0.2},
    "far": {"far": 5.0, "near": 1.0},
    "absgrad": {"absgrad": True},
}


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The stand-in installed, and taken for CPU tensors, since there are no others here."""
    monkeypatch.setitem(RASTERIZE.DEVICE_OF, "gsplat", "cpu")
    return install(monkeypatch)


def compare(actual: Outcome, wanted: Outcome, tolerance: float) -> None:
    """Images but for single pixels at the alpha threshold, `meta`, and all gradients."""
    for name in ("rgb", "depth", "alpha"):
        difference = (getattr(actual.image, name) - getattr(wanted.image, name)).detach().abs()
        assert float(difference.max()) < 5e-3, name
        assert float(difference.mean()) < tolerance / 10, name
    got, expected = actual.image.meta, wanted.image.meta
    assert bool(got.visible[expected.visible].all())
    more = got.visible & ~expected.visible
    assert int(more.sum()) <= 0.05 * len(more)
    assert torch.allclose(got.means2d[~more], expected.means2d[~more], atol=1e-3)
    assert float((got.radii - expected.radii)[~more].abs().max()) <= 1
    assert set(actual.gradients) == set(wanted.gradients)
    for name, gradient in wanted.gradients.items():
        assert relative_error(actual.gradients[name], gradient) < tolerance, name
    for name in set(actual.gradients) - {"pose", "background"}:
        assert not actual.gradients[name][more].any(), name


@pytest.mark.parametrize("options", OPTIONS)
def test_translation_gives_our_images_and_gradients(options: str, stand_in: ModuleType) -> None:
    gaussians = random_gaussians("normal", count=150)
    actual = render_with_gradients(gaussians, "gsplat", torch.float32, **OPTIONS[options])
    wanted = render_with_gradients(gaussians, "reference", torch.float64, **OPTIONS[options])
    assert len(stand_in.calls) == 1
    compare(actual, wanted, 5e-5)


@pytest.mark.parametrize("degree", [0, 2])
def test_harmonics_of_other_degrees(degree: int, stand_in: ModuleType) -> None:
    gaussians = random_gaussians("normal", count=60, degree=degree)
    actual = render_with_gradients(gaussians, "gsplat", torch.float32)
    wanted = render_with_gradients(gaussians, "reference", torch.float64)
    compare(actual, wanted, 5e-5)


@pytest.mark.usefixtures("stand_in")
def test_culled_rows_show_no_rubbish() -> None:
    gaussians = random_gaussians("normal", count=60)
    gaussians.means[::2, 2] -= 50
    meta = rasterize(gaussians, camera(), K, WIDTH, HEIGHT, backend="gsplat").meta
    assert not meta.visible[::2].any()
    assert not meta.means2d[::2].any() and not meta.radii[::2].any()
    assert meta.means2d_grad is None


def test_no_gaussians(stand_in: ModuleType) -> None:
    none = random_gaussians("normal", count=5).select(torch.zeros(0, dtype=torch.int64))
    none.means.requires_grad_()
    pose = camera().requires_grad_()
    background = torch.tensor([0.1, 0.2, 0.3])
    image = rasterize(none, pose, K, WIDTH, HEIGHT, background=background, backend="gsplat")
    assert torch.equal(image.rgb, background.expand(HEIGHT, WIDTH, 3))
    assert not image.alpha.any() and not image.depth.any()
    (image.rgb.sum() + image.depth.sum() + image.alpha.sum()).backward()
    assert none.means.grad.shape == (0, 3) and not pose.grad.any()
    assert image.meta.means2d_grad.shape == (0, 2) and image.meta.means2d_absgrad is None
    image = rasterize(none, pose, K, WIDTH, HEIGHT, absgrad=True, backend="gsplat")
    image.rgb.sum().backward()
    assert image.meta.means2d_absgrad.shape == (0, 2)
    assert stand_in.calls == []


def test_a_view_without_a_backward_pass_is_freed(stand_in: ModuleType) -> None:
    def probe(gradient: torch.Tensor) -> None:
        """Lives as long as the graph that it is hung on."""

    alive = weakref.ref(probe)
    plain = random_gaussians("normal", count=20)
    gaussians = replace(plain, means=plain.means.requires_grad_() * 1)
    gaussians.means.register_hook(probe)
    gc.disable()
    try:
        image = rasterize(gaussians, camera(), K, WIDTH, HEIGHT, absgrad=True, backend="gsplat")
        del gaussians, probe
        stand_in.calls.clear()
        assert alive() is not None
        del image
        assert alive() is None
    finally:
        gc.enable()


@pytest.mark.usefixtures("stand_in")
@pytest.mark.parametrize("field", ["means", "quats", "log_scales", "logit_opacities", "sh"])
def test_values_that_are_not_finite_are_named(field: str) -> None:
    gaussians = random_gaussians("normal", count=20)
    getattr(gaussians, field)[17].view(-1)[-1:] = torch.inf
    with pytest.raises(ValueError, match=rf"Gaussians\.{field}: row 17"):
        rasterize(gaussians, camera(), K, WIDTH, HEIGHT, backend="gsplat")
    gaussians = random_gaussians("normal", count=20)
    gaussians.quats[3] = 0
    with pytest.raises(ValueError, match=r"quats.*norm"):
        rasterize(gaussians, camera(), K, WIDTH, HEIGHT, backend="gsplat")


@pytest.mark.usefixtures("stand_in")
def test_values_out_of_range_are_refused() -> None:
    gaussians = random_gaussians("normal", count=20)
    gaussians.log_scales[7, 1] = 15
    with pytest.raises(ValueError, match=r"log_scales: row 7 is out of -60\.\.14"):
        rasterize(gaussians, camera(), K, WIDTH, HEIGHT, backend="gsplat")


def test_the_cap_on_alpha_is_gsplats_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(RASTERIZE.DEVICE_OF, "gsplat", "cpu")
    install(monkeypatch, max_alpha=0.9)
    gaussians = random_gaussians("opaque", count=60)
    actual = render_with_gradients(gaussians, "gsplat", torch.float32)
    wanted = render_with_gradients(gaussians, "reference", torch.float64, max_alpha=0.9)
    compare(actual, wanted, 5e-5)
    with pytest.raises(ValueError, match=r"max_alpha 0\.99.*0\.9 built in"):
        rasterize(gaussians, camera(), K, WIDTH, HEIGHT, backend="gsplat", max_alpha=0.99)
    monkeypatch.delitem(sys.modules, "gsplat.cuda._constants")
    assert cuda.max_alpha() == 0.999  # as in 1.5.3, which has no such module


def test_gsplat_wants_cuda_and_the_kernel_the_cpu() -> None:
    with pytest.raises(ValueError, match=r"Gaussians\.means: on cpu, expected on cuda"):
        rasterize(random_gaussians("normal", 5), camera(), K, WIDTH, HEIGHT, backend="gsplat")
    elsewhere = Gaussians(
        **{k: v.to("meta") for k, v in vars(random_gaussians("normal", 5)).items()}
    )
    with pytest.raises(ValueError, match=r"Gaussians\.means: on meta, expected on cpu"):
        rasterize(elsewhere, camera(), K, WIDTH, HEIGHT)


def test_auto_takes_gsplat_for_its_device(
    stand_in: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    gaussians = random_gaussians("normal", count=20)
    rasterize(gaussians, camera(), K, WIDTH, HEIGHT)
    assert len(stand_in.calls) == 1
    monkeypatch.setitem(RASTERIZE.DEVICE_OF, "gsplat", "cuda")
    rasterize(gaussians, camera(), K, WIDTH, HEIGHT)
    assert len(stand_in.calls) == 1


@pytest.fixture
def no_gsplat(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if it had never been installed."""
    monkeypatch.setitem(sys.modules, "gsplat", None)
    monkeypatch.setitem(RASTERIZE.DEVICE_OF, "gsplat", "cpu")


@pytest.mark.usefixtures("no_gsplat")
def test_without_gsplat_the_mend_is_told() -> None:
    with pytest.raises(InputError, match=r"gsplat: package: .*recast-sim\[cuda\]") as caught:
        rasterize(random_gaussians("normal", 5), camera(), K, WIDTH, HEIGHT)
    assert "\n" not in str(caught.value)


def test_without_kernels_the_mend_is_told(
    stand_in: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    backend = ModuleType("gsplat.cuda._backend")
    backend._C = None
    monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", backend)
    with pytest.raises(InputError, match=r"gsplat: kernels: .*nvcc"):
        rasterize(random_gaussians("normal", 5), camera(), K, WIDTH, HEIGHT)


def test_devices_are_picked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    assert pick_device("auto") == pick_device("cpu") == torch.device("cpu")
    for name, problem in (("cuda", "sees 0 GPUs"), ("toaster", "unknown"), ("meta", "rasterizer")):
        with pytest.raises(InputError, match=problem):
            pick_device(name)

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    install(monkeypatch)
    assert pick_device("auto") == pick_device("cuda") == torch.device("cuda")
    with pytest.raises(InputError, match="sees 1 GPUs"):
        pick_device("cuda:1")
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.warns(RuntimeWarning, match=r"recast-sim\[cuda\]"):
        assert pick_device("auto") == torch.device("cpu")
    with pytest.raises(InputError, match="gsplat: package"):
        pick_device("cuda")


needs_gpu = pytest.mark.skipif(
    not torch.cuda.is_available() or find_spec("gsplat") is None,
    reason="needs a CUDA GPU and gsplat: pip install 'recast-sim[cuda]'",
)


@needs_gpu
@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_gsplat_agrees_with_the_cpu(kind: str, options: str) -> None:
    """Images and gradients of both; the cap on alpha is gsplat's.

    gsplat uses the GPU's fast exponential and adds gradients in no fixed order: 1e-3 in relative
    L2, needles 1e-2, where the CPU kernel has 2e-5 and 5e-4 against the reference in float64.
    """
    gaussians = random_gaussians(kind)
    actual = render_with_gradients(
        gaussians, "auto", torch.float32, device="cuda", **OPTIONS[options]
    )
    wanted = render_with_gradients(
        gaussians, "auto", torch.float32, max_alpha=cuda.max_alpha(), **OPTIONS[options]
    )
    compare(actual, wanted, 1e-2 if kind == "needles" else 1e-3)


@needs_gpu
def test_gsplat_with_nothing_in_view() -> None:
    behind = random_gaussians("normal", count=50).to("cuda")
    behind.means[:, 2] -= 100
    behind.means.requires_grad_()
    image = rasterize(behind, camera(), K, WIDTH, HEIGHT)
    assert not image.rgb.any() and not image.meta.visible.any()
    (image.rgb.sum() + image.depth.sum()).backward()
    assert not behind.means.grad.any()
