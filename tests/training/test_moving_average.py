"""The moving average of the weights."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from recast.core.errors import InputError
from recast.training.state import ExponentialMovingAverage


class Net(nn.Module):
    """A linear layer with a position table and a counter as buffers."""

    pos_emb: Tensor
    steps: Tensor

    def __init__(self, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.linear = nn.Linear(3, 2).to(dtype)
        self.register_buffer("pos_emb", torch.randn(4))
        self.register_buffer("steps", torch.tensor(0))


def test_after_loading_weights_the_average_equals_them() -> None:
    model, published = Net(), Net().state_dict()
    model.load_state_dict(published)

    ema = ExponentialMovingAverage(model)

    assert ema.state_dict().keys() == published.keys()
    assert all(torch.equal(value, published[name]) for name, value in ema.state_dict().items())
    ema.update(model)
    torch.testing.assert_close(ema.state_dict(), dict(published), rtol=0, atol=0)


def test_nothing_of_the_random_start_is_left_after_fine_tuning() -> None:
    # An average begun at the random start would hold 0.9^10 = 35 % of it.
    model = Net()
    with torch.no_grad():
        model.linear.weight.fill_(100.0)
    start = model.linear.weight.detach().clone()
    model.load_state_dict(Net().state_dict())

    ema = ExponentialMovingAverage(model, decay=0.9)
    for _ in range(10):
        ema.update(model)

    torch.testing.assert_close(ema.state_dict()["linear.weight"], model.linear.weight.detach())
    assert float((start - ema.state_dict()["linear.weight"]).min()) > 90


def test_updates_follow_the_recursion() -> None:
    model = Net()
    ema = ExponentialMovingAverage(model, decay=0.75)
    expected = model.linear.bias.detach().clone()
    for step in range(5):
        with torch.no_grad():
            model.linear.bias.fill_(float(step))
        ema.update(model)
        expected = 0.75 * expected + 0.25 * step

    torch.testing.assert_close(ema.state_dict()["linear.bias"], expected)


def test_buffers_are_the_latest_and_not_averaged() -> None:
    model = Net()
    ema = ExponentialMovingAverage(model)
    model.pos_emb.fill_(3.0)
    model.steps.fill_(7)

    ema.update(model)

    assert ema.state_dict()["pos_emb"].tolist() == [3.0] * 4
    assert int(ema.state_dict()["steps"]) == 7


def test_the_average_is_a_copy() -> None:
    model = Net()
    before = model.linear.weight.detach().clone()
    ema = ExponentialMovingAverage(model)
    with torch.no_grad():
        model.linear.weight.zero_()

    assert torch.equal(ema.state_dict()["linear.weight"], before)
    assert not ema.state_dict()["linear.weight"].requires_grad


def test_half_weights_are_averaged_in_float32() -> None:
    model = Net(torch.float16)
    with torch.no_grad():
        model.linear.weight.fill_(1.0)
    ema = ExponentialMovingAverage(model, decay=0.9999)
    with torch.no_grad():
        model.linear.weight.fill_(1.5)
    for _ in range(10):
        ema.update(model)

    average = ema.state_dict()["linear.weight"]
    assert average.dtype == torch.float32
    # float16 next to 1 has steps of 1e-3 and would not move at all
    torch.testing.assert_close(average, torch.full((2, 3), 1 + 0.5 * (1 - 0.9999**10)))
    ema.copy_to(model)
    assert model.linear.weight.dtype == torch.float16


def test_copy_to_gives_the_model_the_averages() -> None:
    model, other = Net(), Net()
    ema = ExponentialMovingAverage(model)

    ema.copy_to(other)

    assert all(
        torch.equal(value, other.state_dict()[name]) for name, value in model.state_dict().items()
    )
    assert other.linear.weight.requires_grad


def test_saved_averages_continue() -> None:
    model = Net()
    first, second = (ExponentialMovingAverage(model, decay=0.5) for _ in range(2))
    with torch.no_grad():
        model.linear.weight.add_(1.0)
    first.update(model)
    second.load_state_dict({name: value.clone() for name, value in first.state_dict().items()})
    first.update(model)
    second.update(model)

    torch.testing.assert_close(first.state_dict(), second.state_dict(), rtol=0, atol=0)


def test_averages_of_another_model_are_refused_and_change_nothing() -> None:
    ema = ExponentialMovingAverage(Net())
    before = {name: value.clone() for name, value in ema.state_dict().items()}
    state = dict(Net().state_dict())
    for wrong, message in [
        ({n: v for n, v in state.items() if n != "pos_emb"}, "pos_emb: is missing"),
        ({**state, "extra": torch.zeros(1)}, "extra: is not expected"),
        ({**state, "pos_emb": torch.zeros(5)}, r"pos_emb: is float32 \[5\], not float32 \[4\]"),
    ]:
        with pytest.raises(InputError, match=message):
            ema.load_state_dict(wrong, "ema.safetensors")

    torch.testing.assert_close(ema.state_dict(), before, rtol=0, atol=0)


def test_a_changed_model_and_a_bad_decay_are_refused() -> None:
    ema = ExponentialMovingAverage(Net())
    with pytest.raises(ValueError, match="have changed"):
        ema.update(nn.Linear(3, 2))
    with pytest.raises(ValueError, match="decay"):
        ExponentialMovingAverage(Net(), decay=1.0)
