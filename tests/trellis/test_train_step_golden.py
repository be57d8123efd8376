"""One training step of each flow against golden losses and gradients."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from recast.training.state import AdaptiveGradClipper, ExponentialMovingAverage
from recast.trellis.flow_transformer import (
    SLatFlowConfig,
    SLatFlowModel,
    SparseStructureFlowConfig,
    SparseStructureFlowModel,
)
from recast.trellis.sampler import FlowLoss, FlowMatching, drop_condition
from recast.trellis.sparse import SparseTensor
from support.trellis import AFTER_TIME, assert_same, golden_config, golden_tensors

FLOW = FlowMatching(sigma_min=1e-5)


def structure_flow() -> SparseStructureFlowModel:
    config = SparseStructureFlowConfig(**golden_config("ss_flow")["args"])
    model = SparseStructureFlowModel(config)
    model.load_published(golden_tensors("ss_flow"))
    return model.train()


def latent_flow() -> SLatFlowModel:
    model = SLatFlowModel(SLatFlowConfig(**golden_config("slat_flow")["args"]))
    model.load_published(golden_tensors("slat_flow"))
    return model.train()


def dropped(golden: dict[str, Tensor]) -> Tensor:
    """The condition with the golden samples dropped: the first seed that draws just those."""
    for seed in range(1000):
        generator = torch.Generator().manual_seed(seed)
        cond, mask = drop_condition(golden["cond"], 0.5, generator)
        if torch.equal(mask, golden["drop_mask"]):
            return cond
    raise AssertionError("no seed draws the golden mask")


def check_inputs(golden: dict[str, Tensor], batch: Tensor | None) -> None:
    x_t = FLOW.interpolate(golden["x_0"], golden["noise"], golden["t"], batch)
    assert_same(x_t, golden["x_t"])
    assert_same(FLOW.target(golden["x_0"], golden["noise"]), golden["target"])


def check_gradients(model: nn.Module, golden: dict[str, Tensor]) -> None:
    gradients = {
        name: parameter.grad
        for name, parameter in model.named_parameters()
        if parameter.grad is not None
    }
    norms = {key.removeprefix("gradnorm/"): v for key, v in golden.items() if "gradnorm/" in key}
    assert gradients.keys() == norms.keys()
    for name, norm in norms.items():
        assert float(gradients[name].norm()) == pytest.approx(float(norm), rel=AFTER_TIME), name
    full = [key for key in golden if key.startswith("grad/")]
    assert len(full) >= 6
    for key in full:
        assert_same(gradients[key.removeprefix("grad/")], golden[key], AFTER_TIME)
    total = AdaptiveGradClipper(max_norm=1e9).clip(model.parameters())
    assert total == pytest.approx(float(golden["grad_total_norm"]), rel=AFTER_TIME)


def structure_loss(model: nn.Module, golden: dict[str, Tensor], seen: list[Tensor]) -> FlowLoss:
    def velocity(x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        assert_same(t, golden["t_model"])
        seen.append(model(x, t, cond))
        return seen[-1]

    return FLOW.loss(velocity, golden["x_0"], dropped(golden), golden["t"], golden["noise"])


def latent_loss(model: nn.Module, golden: dict[str, Tensor], seen: list[Tensor]) -> FlowLoss:
    start = SparseTensor(golden["coords"], golden["x_0"], batch_size=2)

    def velocity(x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        assert_same(t, golden["t_model"])
        seen.append(model(start.with_feats(x), t, cond).feats)
        return seen[-1]

    return FLOW.loss(
        velocity, start.feats, dropped(golden), golden["t"], golden["noise"], start.batch
    )


@pytest.mark.parametrize("checkpointing", [False, True])
def test_structure_flow_step(checkpointing: bool) -> None:
    golden, model, seen = golden_tensors("train_ss_flow"), structure_flow(), []
    model.checkpointing = checkpointing
    check_inputs(golden, None)

    found = structure_loss(model, golden, seen)
    found.loss.backward()

    assert_same(seen[0].detach(), golden["pred"], AFTER_TIME)
    assert_same(found.loss.detach(), golden["loss"], AFTER_TIME)
    check_gradients(model, golden)


@pytest.mark.parametrize("checkpointing", [False, True])
def test_latent_flow_step(checkpointing: bool) -> None:
    golden, model, seen = golden_tensors("train_slat_flow"), latent_flow(), []
    model.checkpointing = checkpointing
    check_inputs(golden, golden["coords"][:, 0].long())

    found = latent_loss(model, golden, seen)
    found.loss.backward()

    assert_same(seen[0].detach(), golden["pred"], AFTER_TIME)
    assert_same(found.loss.detach(), golden["loss"], AFTER_TIME)
    check_gradients(model, golden)
    # Rows, not samples, have equal weight: the two samples hold 180 and 110 of them.
    weighted = (found.per_sample * torch.tensor([180.0, 110.0])).sum() / 290
    assert_same(weighted, golden["loss"], AFTER_TIME)
    assert float(found.per_sample.mean()) != pytest.approx(float(golden["loss"]), rel=1e-4)


def test_average_of_a_loaded_network_is_the_published_weights_through_a_step_of_rate_zero() -> None:
    golden, model = golden_tensors("train_ss_flow"), structure_flow()
    published = golden_tensors("ss_flow")
    average = ExponentialMovingAverage(model)
    optimiser = torch.optim.AdamW(model.parameters(), lr=0.0, weight_decay=0.0)

    structure_loss(model, golden, []).loss.backward()
    optimiser.step()
    average.update(model)

    assert "pos_emb" in published
    assert "pos_emb" not in dict(model.named_parameters())  # no optimiser moves it
    assert average.state_dict().keys() == published.keys()
    for name, value in average.state_dict().items():
        assert torch.equal(value, published[name]), name
