from __future__ import annotations

import copy
from typing import Any

import pytest
import torch
from pydantic import ValidationError
from torch import Tensor

from recast.trellis.flow_transformer import (
    SparseStructureFlowConfig,
    SparseStructureFlowModel,
    patchify,
    unpatchify,
)
from support.trellis import AFTER_TIME, assert_same, golden_config, golden_tensors, half_bound


def golden_model(name: str, **changes: Any) -> SparseStructureFlowModel:
    config = SparseStructureFlowConfig(**golden_config(name)["args"] | changes)
    model = SparseStructureFlowModel(config)
    model.load_published(golden_tensors(name))
    return model


def run(model: SparseStructureFlowModel, io: dict[str, Tensor]) -> Tensor:
    out: Tensor = model(io["x"], io["t"], io["cond"])
    return out


@torch.no_grad()
def test_output_and_every_block_equal_the_published_code() -> None:
    model, io = golden_model("ss_flow"), golden_tensors("ss_flow_io")
    seen: dict[str, Tensor] = {}

    def keep(name: str) -> Any:
        return lambda module, inputs, output: seen.update({name: output.detach()})

    model.t_embedder.register_forward_hook(keep("t_emb"))
    for i, block in enumerate(model.blocks):
        block.register_forward_hook(keep(f"block{i}"))
    assert_same(run(model, io), io["out"], AFTER_TIME)
    for name, found in seen.items():
        assert_same(found, io[name], AFTER_TIME)
    assert set(seen) == {"t_emb", "block0", "block1"}


@torch.no_grad()
def test_patches_shared_modulation_and_cross_norm_equal_the_published_code() -> None:
    io = golden_tensors("ss_flow_variant_io")
    assert_same(run(golden_model("ss_flow_variant"), io), io["out"], AFTER_TIME)


def test_position_embedding_is_saved_and_equals_the_published_one() -> None:
    for name in ("ss_flow", "ss_flow_variant"):
        model = SparseStructureFlowModel(SparseStructureFlowConfig(**golden_config(name)["args"]))
        assert_same(model.published_state()["pos_emb"], golden_tensors(name)["pos_emb"])
        assert "pos_emb" not in dict(model.named_parameters())


@torch.no_grad()
def test_half_torso_stays_near_the_published_one() -> None:
    model, io = golden_model("ss_flow", use_fp16=True), golden_tensors("ss_flow_io")
    out = run(model, io)
    assert out.dtype == torch.float32
    assert_same(out, io["out"], half_bound(model))
    assert_same(out, io["out_fp16_torso"], 2 * half_bound(model))
    assert not torch.equal(out, run(golden_model("ss_flow"), io))


def test_half_torso_converts_linear_layers_only() -> None:
    model = golden_model("ss_flow", use_fp16=True)
    for name, tensor in model.published_state().items():
        half = name.startswith("blocks.") and "norm" not in name
        assert tensor.dtype == (torch.float16 if half else torch.float32), name


def test_patches_are_ordered_and_inverted() -> None:
    x = torch.arange(2 * 3 * 64, dtype=torch.float32).reshape(2, 3, 4, 4, 4)
    tokens = patchify(x, 2)
    assert tokens.shape == (2, 8, 24)
    # Token 1 is the next patch along z; its channels run C, px, py, pz.
    assert torch.equal(tokens[1, 1], x[1, :, :2, :2, 2:].reshape(-1))
    assert torch.equal(unpatchify(tokens, 4, 2), x)


def test_checkpointing_gives_the_same_gradients() -> None:
    plain, io = golden_model("ss_flow"), golden_tensors("ss_flow_io")
    saving = copy.deepcopy(plain)
    saving.checkpointing = True
    calls: list[int] = []
    saving.blocks[0].register_forward_pre_hook(lambda *_: calls.append(1))
    outputs = [run(model, io) for model in (plain, saving)]
    assert torch.equal(outputs[0], outputs[1])
    for out in outputs:
        out.square().mean().backward()
    assert len(calls) == 2  # once forward, once again for the backward pass
    for a, b in zip(plain.parameters(), saving.parameters(), strict=True):
        assert a.grad is not None
        assert b.grad is not None
        assert torch.equal(a.grad, b.grad)


@torch.no_grad()
def test_a_new_model_predicts_no_velocity() -> None:
    model = SparseStructureFlowModel(SparseStructureFlowConfig(**golden_config("ss_flow")["args"]))
    assert not run(model, golden_tensors("ss_flow_io")).any()
    assert not model.blocks[0].adaLN_modulation[1].weight.any()  # type: ignore[union-attr, index]
    assert 0.018 < float(model.t_embedder.mlp[0].weight.std()) < 0.022
    bound = (6 / (8 + 64)) ** 0.5
    weight = model.input_layer.weight.abs().max()
    assert 0.9 * bound < float(weight) <= bound


def test_wrong_grid_is_refused() -> None:
    io = golden_tensors("ss_flow_io")
    with pytest.raises(ValueError, match="expected 8 channels on a grid of 4"):
        golden_model("ss_flow")(io["x"][:, :, :2], io["t"], io["cond"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"num_heads": 5}, "do not divide into 5 heads"),
        ({"patch_size": 3}, "does not divide resolution 4"),
        ({"pe_mode": "rope"}, "pe_mode"),
        ({"colour": 1}, "colour"),
        ({"num_blocks": -1}, "num_blocks"),
    ],
)
def test_wrong_arguments_are_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        SparseStructureFlowConfig(**golden_config("ss_flow")["args"] | change)
