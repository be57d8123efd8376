"""What the image cannot change is computed once, and again when anything behind it changes."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from recast.planning.gtrs import GtrsModel, new_model
from recast.planning.gtrs.model import TensorCache
from support.tiny_gtrs import TINY, fan


def _scores(model: GtrsModel, vocabulary: Tensor) -> dict[str, Tensor]:
    dtype, generator = vocabulary.dtype, torch.Generator().manual_seed(5)
    features = torch.randn(2, 24, 2, 4, generator=generator, dtype=dtype)
    return model.score(
        model.look(features), torch.randn(2, 8, generator=generator, dtype=dtype), vocabulary
    )


class Counting:
    """Counts how often a model's vocabulary is encoded."""

    def __init__(self, model: GtrsModel) -> None:
        self.calls = 0
        model.head.encoder.register_forward_hook(self._count)

    def _count(self, *_: object) -> None:
        self.calls += 1


@pytest.fixture
def model() -> GtrsModel:
    return new_model(TINY, torch.Generator().manual_seed(2))


CHANGES: dict[str, Callable[[GtrsModel], object]] = {
    "in place": lambda m: m.head.pos_embed[0].weight.mul_(1.5),
    "through data": lambda m: m.head.encoder.norm3.bias.data.add_(0.1),
    "self-attention": lambda m: m.head.transformer.first.self_attn.in_proj_weight.mul_(1.5),
    "norm": lambda m: m.head.transformer.first.norm1.weight.mul_(0.5),
    "loaded": lambda m: m.load_state_dict(
        new_model(TINY, torch.Generator().manual_seed(3)).state_dict()
    ),
}


@torch.no_grad()
@pytest.mark.parametrize("change", CHANGES)
def test_new_weights_are_noticed(model: GtrsModel, change: str) -> None:
    # In double: a batch of two multiplies in another order than a batch of one, and the widest
    # kernels round float32 differently by up to 5e-5 of a small logit.
    model = model.double()
    vocabulary, counting = torch.from_numpy(fan(9)).double(), Counting(model)
    _scores(model, vocabulary)
    _scores(model, vocabulary.clone())
    assert counting.calls == 1
    CHANGES[change](model)
    found = _scores(model, vocabulary)
    assert counting.calls == 2
    plain = _scores(model, vocabulary.expand(2, -1, -1, -1))
    for name, logits in plain.items():
        torch.testing.assert_close(found[name], logits, rtol=1e-10, atol=1e-10)


@torch.no_grad()
def test_another_vocabulary_is_noticed(model: GtrsModel) -> None:
    vocabulary, counting = torch.from_numpy(fan(9)), Counting(model)
    before = _scores(model, vocabulary)
    vocabulary[3] *= 1.25  # written in place: the same tensor holds another vocabulary
    after = _scores(model, vocabulary)
    _scores(model, vocabulary[:5])
    assert counting.calls == 3
    assert not torch.equal(before["imi"], after["imi"])


def test_gradients_are_never_taken_from_the_cache(model: GtrsModel) -> None:
    vocabulary = torch.from_numpy(fan(9))
    with torch.no_grad():
        _scores(model, vocabulary)
    _scores(model, vocabulary)["imi"].sum().backward()
    gradient = model.head.pos_embed[0].weight.grad
    assert gradient is not None and gradient.abs().sum() > 0


def test_a_failed_computation_leaves_nothing() -> None:
    cache, x = TensorCache(), torch.zeros(2)
    cache.get([x], lambda: x + 1)

    def fail() -> Tensor:
        raise RuntimeError("out of memory")

    with pytest.raises(RuntimeError):
        cache.get([x + 1], fail)
    assert cache.get([x], lambda: x + 7).tolist() == [7.0, 7.0]
