"""Adam over visible rows: compiled against plain torch, and both against the textbook."""

from __future__ import annotations

import math

import pytest
import torch

from recast.splats import RowAdam, native

SHAPES: dict[str, tuple[int, ...]] = {
    "means": (3,),
    "quats": (4,),
    "log_scales": (3,),
    "logit_opacities": (),
    "sh": (4, 3),
}
RATES = {name: 0.01 * (i + 1) for i, name in enumerate(SHAPES)}


def parameters(count: int, seed: int = 0) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return {
        name: torch.randn(count, *shape, generator=generator).requires_grad_()
        for name, shape in SHAPES.items()
    }


def give_gradients(params: dict[str, torch.Tensor], seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    for p in params.values():
        p.grad = torch.randn(p.shape, generator=generator) * 1e-3


def visible_rows(count: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count // 7 + 1, generator=generator).repeat_interleave(7)[:count] < 0.6


def check_against_reference(backend: str, count: int) -> None:
    options = {
        "column_rates": {"sh": torch.tensor([1.0, 0.05, 0.05, 0.05])[:, None]},
        "bounds": {"log_scales": (-0.5, math.inf), "sh": (torch.full((4, 3), -1.5), 1.5)},
    }
    quick, plain = parameters(count), parameters(count)
    first = RowAdam(quick, RATES, backend=backend, **options)
    second = RowAdam(plain, RATES, backend="reference", **options)
    for step in range(5):
        give_gradients(quick, step)
        give_gradients(plain, step)
        visible = visible_rows(count, step)
        first.step(visible)
        second.step(visible)
    for name in SHAPES:
        assert torch.allclose(quick[name], plain[name], atol=2e-6, rtol=1e-5), name
    state, wanted = first.state_dict(), second.state_dict()
    for name, value in wanted.items():
        atol = 1e-10 if name.startswith("first") else 1e-14
        assert torch.allclose(state[name], value, rtol=1e-5, atol=atol), name


def test_compiled_matches_reference(isa: str) -> None:
    check_against_reference("native", 9000)  # more than one work item


def test_foreach_matches_reference() -> None:
    check_against_reference("foreach", 500)


@pytest.mark.parametrize("backend", ["native", "foreach", "reference"])
@pytest.mark.usefixtures("compiled")
def test_three_steps_by_the_textbook(backend: str) -> None:
    params = parameters(50)
    adam = RowAdam(params, RATES, backend=backend)
    wanted = {name: p.detach().double() for name, p in params.items()}
    mean = {name: torch.zeros_like(p) for name, p in wanted.items()}
    variance = {name: torch.zeros_like(p) for name, p in wanted.items()}
    for step in range(1, 4):
        give_gradients(params, step)
        adam.step(torch.ones(50, dtype=torch.bool))
        for name, p in params.items():
            assert p.grad is not None
            g = p.grad.double()
            mean[name] = 0.9 * mean[name] + 0.1 * g
            variance[name] = 0.999 * variance[name] + 0.001 * g * g
            fraction = (mean[name] / (1 - 0.9**step)) / (variance[name] / (1 - 0.999**step)).sqrt()
            wanted[name] = wanted[name] - RATES[name] * fraction
    for name in SHAPES:
        assert torch.allclose(params[name].double(), wanted[name], atol=1e-5), name


@pytest.mark.parametrize("backend", ["native", "foreach", "reference"])
@pytest.mark.usefixtures("compiled")
def test_rows_not_visible_stay(backend: str) -> None:
    params = parameters(100)
    before = {name: p.detach().clone() for name, p in params.items()}
    adam = RowAdam(params, RATES, backend=backend)
    visible = visible_rows(100, 1)
    for step in range(3):
        give_gradients(params, step)
        adam.step(visible)
    state = adam.state_dict()
    for name, p in params.items():
        assert torch.equal(p[~visible], before[name][~visible])
        assert not torch.equal(p[visible], before[name][visible])
        assert not state[f"first.{name}"][~visible].any()


def test_rows_that_moved_are_told() -> None:
    params = parameters(3)
    adam = RowAdam(params, RATES)
    assert not adam.moved.any()
    give_gradients(params, 1)
    adam.step(torch.tensor([False, True, False]))
    assert adam.moved.tolist() == [False, True, False]
    adam.append(1)
    assert adam.moved.tolist() == [False, True, False, False]


@pytest.mark.usefixtures("compiled")
def test_parameters_without_gradient_stay() -> None:
    params = parameters(10)
    give_gradients(params, 0)
    params["quats"].grad = None
    before = params["quats"].detach().clone()
    RowAdam(params, RATES).step(torch.ones(10, dtype=torch.bool))
    assert torch.equal(params["quats"], before)


@pytest.mark.usefixtures("compiled")
def test_rates_of_a_step_and_strided_gradients() -> None:
    params, plain = parameters(30), parameters(30)
    adam, wanted = RowAdam(params, {}), RowAdam(plain, RATES)
    give_gradients(params, 0)
    give_gradients(plain, 0)
    params["sh"].grad = params["sh"].grad.transpose(0, 1).contiguous().transpose(0, 1)
    adam.step(torch.ones(30, dtype=torch.bool), RATES)
    wanted.step(torch.ones(30, dtype=torch.bool))
    assert all(torch.equal(params[name], plain[name]) for name in SHAPES)


def test_moments_follow_rows_and_survive_a_save() -> None:
    params = parameters(20)
    adam = RowAdam(params, RATES)
    give_gradients(params, 0)
    adam.step(torch.ones(20, dtype=torch.bool))
    old = {name: value.clone() for name, value in adam.state_dict().items()}
    index = torch.tensor([5, 3, 19])
    adam.select(index)
    adam.append(2)
    state = adam.state_dict()
    for name in SHAPES:
        assert torch.equal(state[f"first.{name}"][:3], old[f"first.{name}"][index])
        assert not state[f"second.{name}"][3:].any()
    adam.params = parameters(5)
    give_gradients(adam.params, 1)
    adam.step(torch.ones(5, dtype=torch.bool))

    again = RowAdam(parameters(5), RATES)
    again.load_state_dict(adam.state_dict())
    assert again.steps == 2
    again.params = {name: p.detach().clone().requires_grad_() for name, p in adam.params.items()}
    for optimiser in (adam, again):
        give_gradients(optimiser.params, 2)
        optimiser.step(torch.ones(5, dtype=torch.bool))
    assert all(torch.equal(adam.params[name], again.params[name]) for name in SHAPES)


def test_wrong_shapes_are_named() -> None:
    params = parameters(10)
    give_gradients(params, 0)
    adam = RowAdam(params, RATES)
    with pytest.raises(ValueError, match="visible"):
        adam.step(torch.ones(9, dtype=torch.bool))
    adam.select(torch.arange(4))
    with pytest.raises(ValueError, match="moments"):
        adam.step(torch.ones(10, dtype=torch.bool))
    with pytest.raises(ValueError, match="numbers of rows"):
        RowAdam({"a": torch.zeros(2), "b": torch.zeros(3)}, {})


def test_the_compiled_kernel_wants_the_cpu() -> None:
    with pytest.raises(ValueError, match="on the CPU"):
        RowAdam({"a": torch.zeros(2, device="meta")}, {}, backend="native")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA GPU")
def test_the_gpu_agrees_with_the_cpu() -> None:
    options = {
        "column_rates": {"sh": torch.tensor([1.0, 0.05, 0.05, 0.05])[:, None]},
        "bounds": {"log_scales": (-0.5, math.inf), "sh": (torch.full((4, 3), -1.5), 1.5)},
    }
    plain = parameters(5000)
    there = {name: p.detach().cuda().requires_grad_() for name, p in plain.items()}
    first, second = RowAdam(there, RATES, **options), RowAdam(plain, RATES, **options)
    for step in range(5):
        give_gradients(plain, step)
        for name, p in there.items():
            p.grad = plain[name].grad.cuda()
        visible = visible_rows(5000, step)
        first.step(visible.cuda())
        second.step(visible)
    for name in SHAPES:
        assert torch.allclose(there[name].cpu(), plain[name], atol=2e-6, rtol=1e-5), name


def test_long_unhit_rows_do_not_slow_down() -> None:
    """Moments that decay for ever end at zero, not in denormal numbers."""
    if not native.info().available:
        pytest.skip(native.info().reason)
    params = {"a": torch.zeros(64).requires_grad_()}
    adam = RowAdam(params, {"a": 0.0})
    params["a"].grad = torch.full((64,), 1e-8)
    adam.step(torch.ones(64, dtype=torch.bool))
    params["a"].grad = torch.zeros(64)
    for _ in range(700):
        adam.step(torch.ones(64, dtype=torch.bool))
    assert not adam.state_dict()["first.a"].any()
