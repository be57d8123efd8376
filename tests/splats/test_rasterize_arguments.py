"""Bad input to `rasterize`, the choice of backend, and what it says without a compiled library."""

from __future__ import annotations

import math
import warnings

import pytest
import torch

from recast import kernel
from recast.splats import Gaussians, native, rasterize
from support.splat_scenes import HEIGHT, WIDTH, K, camera, random_gaussians


@pytest.mark.parametrize("backend", ["native", "reference"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("field", ["means", "quats", "log_scales", "logit_opacities", "sh"])
@pytest.mark.usefixtures("compiled")
def test_values_that_are_not_finite_are_named(field: str, value: float, backend: str) -> None:
    gaussians = random_gaussians("normal", count=40)
    gaussians.means[17] = torch.tensor([0.0, 0.0, 4.0])  # seen: harmonics are read for those only
    getattr(gaussians, field)[17].view(-1)[-1:] = value
    with pytest.raises(ValueError, match=rf"Gaussians\.{field}: row 17"):
        rasterize(gaussians, camera(), K, WIDTH, HEIGHT, backend=backend)


@pytest.mark.parametrize("backend", ["native", "reference"])
@pytest.mark.usefixtures("compiled")
def test_quaternion_of_norm_zero(backend: str) -> None:
    gaussians = random_gaussians("normal", count=40)
    gaussians.quats[3] = 0
    with pytest.raises(ValueError, match=r"quats.*norm"):
        rasterize(gaussians, camera(), K, WIDTH, HEIGHT, backend=backend)


@pytest.mark.usefixtures("compiled")
def test_scale_beyond_all_bounds() -> None:
    gaussians = random_gaussians("normal", count=40)
    gaussians.log_scales[3, 1] = 15
    with pytest.raises(ValueError, match="log_scales: row 3"):
        rasterize(gaussians, camera(), K, WIDTH, HEIGHT, backend="native")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": torch.eye(4)}, "K: shape"),
        ({"K": torch.zeros(3, 3)}, "K: focal lengths"),
        ({"K": torch.tensor([[70, 1, 44.0], [0, 72, 31], [0, 0, 1]])}, "skew"),
        ({"camera_from_world": torch.eye(3)}, "camera_from_world: shape"),
        ({"camera_from_world": 2 * torch.eye(4)}, "not a rigid"),
        ({"camera_from_world": torch.full((4, 4), math.nan)}, "not finite"),
        ({"width": 0}, "0x"),
        ({"near": 0.0}, "near"),
        ({"eps2d": -1.0}, "eps2d"),
        ({"max_alpha": 1.0}, "max_alpha"),
        ({"background": torch.zeros(4)}, "background: shape"),
        ({"backend": "cuda"}, "backend"),
    ],
)
def test_bad_arguments_are_named(change: dict[str, object], message: str) -> None:
    arguments = {
        "gaussians": random_gaussians("normal", count=5),
        "camera_from_world": camera(),
        "K": K,
        "width": WIDTH,
        "height": HEIGHT,
        **change,
    }
    with pytest.raises(ValueError, match=message):
        rasterize(**arguments)


def test_bad_shapes_are_named() -> None:
    good = vars(random_gaussians("normal", count=5))
    for field, shape in (("quats", (5, 3)), ("means", (5, 4)), ("sh", (5, 5, 3)), ("sh", (5, 3))):
        with pytest.raises(ValueError, match=f"Gaussians.{field}: shape"):
            rasterize(Gaussians(**{**good, field: torch.ones(shape)}), camera(), K, WIDTH, HEIGHT)
    with pytest.raises(ValueError, match=r"Gaussians\.sh: dtype"):
        rasterize(Gaussians(**{**good, "sh": good["sh"].double()}), camera(), K, WIDTH, HEIGHT)


def test_other_devices_are_refused() -> None:
    good = vars(random_gaussians("normal", count=5))
    elsewhere = Gaussians(**{**good, "sh": good["sh"].to("meta")})
    with pytest.raises(ValueError, match=r"Gaussians\.sh: on meta"):
        rasterize(elsewhere, camera(), K, WIDTH, HEIGHT)


@pytest.fixture
def no_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if recast had been installed without a compiler."""
    from importlib import import_module

    monkeypatch.setattr(kernel, "_candidates", list)
    kernel._load.cache_clear()
    import_module("recast.splats.rasterize")._warn_once.cache_clear()
    yield
    kernel._load.cache_clear()


@pytest.mark.usefixtures("no_library")
def test_without_a_library_the_reference_runs_with_one_warning() -> None:
    gaussians = random_gaussians("normal", count=5)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(2):
            image = rasterize(gaussians, camera(), K, 20, 10)
    assert [w.category for w in caught] == [RuntimeWarning]
    assert "C++ compiler" in str(caught[0].message)
    assert image.rgb.shape == (10, 20, 3)
    info = native.info()
    assert not info.available
    assert info.library is None
    assert "not built" in info.reason


@pytest.mark.usefixtures("no_library")
def test_without_a_library_native_is_refused() -> None:
    with pytest.raises(RuntimeError, match="not built"):
        rasterize(random_gaussians("normal", count=5), camera(), K, 20, 10, backend="native")


def test_unknown_instruction_set_in_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    if not native.info().available:
        pytest.skip(native.info().reason)
    monkeypatch.setenv("RECAST_ISA", "mmx")
    kernel._load.cache_clear()
    try:
        with pytest.raises(RuntimeError, match="RECAST_ISA=mmx"):
            native.info()
    finally:
        kernel._load.cache_clear()


def test_threads_must_be_positive() -> None:
    with pytest.raises(ValueError, match="set_threads"):
        native.set_threads(0)


def test_info_names_what_runs() -> None:
    info = native.info()
    if not info.available:
        pytest.skip(info.reason)
    assert info.isa in info.isas
    assert info.isas[-1] == "portable"
    assert info.library is not None
    assert info.library.is_file()
    assert info.threads >= 1
