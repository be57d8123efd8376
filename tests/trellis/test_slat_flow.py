from __future__ import annotations

import copy
from typing import Any

import pytest
import torch
from tests.trellis.sparse_samples import one_sample
from torch import Tensor, nn

from recast.trellis.flow_transformer import SLatFlowConfig, SLatFlowModel
from recast.trellis.layers import LayerNorm32, SparseResBlock3d
from recast.trellis.sparse import SparseTensor, pool, unpool
from support.trellis import AFTER_TIME, assert_same, golden_config, golden_tensors, half_bound


def golden_model(**changes: Any) -> SLatFlowModel:
    model = SLatFlowModel(SLatFlowConfig(**golden_config("slat_flow")["args"] | changes))
    model.load_published(golden_tensors("slat_flow"))
    return model


@pytest.fixture(scope="module")
def io() -> dict[str, Tensor]:
    return golden_tensors("slat_flow_io")


def voxels(io: dict[str, Tensor]) -> SparseTensor:
    return SparseTensor(io["coords"], io["feats"], 2)


@torch.no_grad()
def run(model: SLatFlowModel, io: dict[str, Tensor]) -> SparseTensor:
    out: SparseTensor = model(voxels(io), io["t"], io["cond"])
    return out


def test_output_and_every_module_equal_the_published_code(io: dict[str, Tensor]) -> None:
    model = golden_model()
    seen: dict[str, Any] = {}

    def keep(name: str) -> Any:
        return lambda module, inputs, output: seen.update({name: output})

    for prefix, blocks in (
        ("input_block", model.input_blocks),
        ("block", model.blocks),
        ("out_block", model.out_blocks),
    ):
        for i, block in enumerate(blocks):
            block.register_forward_hook(keep(f"{prefix}{i}"))
    out = run(model, io)
    assert_same(out.feats, io["out"], AFTER_TIME)
    assert torch.equal(out.coords, io["coords"])
    assert torch.equal(seen["input_block1"].coords, io["down_coords"])
    assert torch.equal(seen["out_block0"].coords, io["coords"])
    assert len(seen) == 6
    for name, output in seen.items():
        feats = output.feats if isinstance(output, SparseTensor) else output
        assert_same(feats, io[name], AFTER_TIME)


def test_half_torso_stays_near_the_published_one(io: dict[str, Tensor]) -> None:
    model = golden_model(use_fp16=True)
    out = run(model, io).feats
    assert out.dtype == torch.float32
    assert_same(out, io["out"], half_bound(model))
    assert_same(out, io["out_fp16_torso"], 2 * half_bound(model))
    assert not torch.equal(out, run(golden_model(), io).feats)


def test_half_torso_converts_linear_and_convolution_layers_only() -> None:
    for name, tensor in golden_model(use_fp16=True).published_state().items():
        torso = name.split(".")[0] in ("input_blocks", "blocks", "out_blocks")
        half = torso and "norm" not in name
        assert tensor.dtype == (torch.float16 if half else torch.float32), name


def test_a_batch_of_two_equals_the_two_alone(io: dict[str, Tensor]) -> None:
    model, x = golden_model(), voxels(io)
    both = run(model, io)
    for i in range(2):
        with torch.no_grad():
            alone = model(one_sample(x, i), io["t"][i : i + 1], io["cond"][i : i + 1])
        assert_same(one_sample(both, i).feats, alone.feats)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_an_empty_sample_changes_nothing(io: dict[str, Tensor], place: int) -> None:
    coords = io["coords"].clone()
    coords[:, 0] += (coords[:, 0] >= place).int()
    rows = [i for i in range(3) if i != place]
    t, cond = torch.full((3,), 500.0), torch.ones(3, 21, 48)
    t[rows], cond[rows] = io["t"], io["cond"]
    with torch.no_grad():
        out = golden_model()(SparseTensor(coords, io["feats"], 3), t, cond)
    assert out.batch_size == 3
    assert out.counts[place] == 0
    assert_same(out.feats, io["out"], AFTER_TIME)


def test_no_voxels_at_all(io: dict[str, Tensor]) -> None:
    nothing = SparseTensor(io["coords"][:0], io["feats"][:0], 2)
    assert golden_model()(nothing, io["t"], io["cond"]).feats.shape == (0, 8)


def test_the_order_of_the_voxels_does_not_matter(io: dict[str, Tensor]) -> None:
    generator = torch.Generator().manual_seed(0)
    parts = (torch.randperm(n, generator=generator) for n in (180, 110))
    order = torch.cat([part + start for part, start in zip(parts, (0, 180), strict=True)])
    mixed = io | {"coords": io["coords"][order], "feats": io["feats"][order]}
    assert_same(run(golden_model(), mixed).feats, io["out"][order], AFTER_TIME)


def test_checkpointing_gives_the_same_gradients(io: dict[str, Tensor]) -> None:
    plain = golden_model()
    saving = copy.deepcopy(plain)
    saving.checkpointing = True
    calls: list[str] = []
    for block in (saving.input_blocks[1], saving.blocks[0], saving.out_blocks[0]):
        block.register_forward_pre_hook(lambda module, *_: calls.append(type(module).__name__))
    for model in (plain, saving):
        model(voxels(io), io["t"], io["cond"]).feats.square().mean().backward()
    assert len(calls) == 6  # each once forward, once again for the backward pass
    for a, b in zip(plain.parameters(), saving.parameters(), strict=True):
        assert a.grad is not None
        assert b.grad is not None
        assert torch.equal(a.grad, b.grad)


def test_a_new_model_predicts_no_velocity(io: dict[str, Tensor]) -> None:
    model = SLatFlowModel(SLatFlowConfig(**golden_config("slat_flow")["args"]))
    assert not run(model, io).feats.any()
    for block in (*model.input_blocks, *model.out_blocks):
        assert not block.conv2.conv.weight.any()
        assert block.conv1.conv.weight.any()
    for block in model.blocks:
        assert not block.adaLN_modulation[1].weight.any()


def test_initial_weights_come_from_the_generator() -> None:
    model = SLatFlowModel(SLatFlowConfig(**golden_config("slat_flow")["args"]))
    states = []
    for _ in range(2):
        model.initialise(torch.Generator().manual_seed(5))
        states.append(copy.deepcopy(model.published_state()))
    for name, value in states[0].items():
        assert torch.equal(value, states[1][name]), name


def test_levels_follow_the_configuration(io: dict[str, Tensor]) -> None:
    args = golden_config("slat_flow")["args"]
    deep = args | {"patch_size": 4, "io_block_channels": [8, 16], "num_io_res_blocks": 1}
    cases = (
        (deep, [(8, 16), (16, 64)], [(128, 16), (32, 8)]),
        (deep | {"use_skip_connection": False}, [(8, 16), (16, 64)], [(64, 16), (16, 8)]),
        (args | {"io_block_channels": None, "share_mod": True}, [], []),
    )
    for changed, down, up in cases:
        model = SLatFlowModel(SLatFlowConfig(**changed))
        model.initialise(torch.Generator().manual_seed(0))
        for blocks, expected in ((model.input_blocks, down), (model.out_blocks, up)):
            found = [(b.conv1.in_channels, b.conv1.out_channels) for b in blocks]
            assert found == expected
        nn.init.ones_(model.out_layer.weight)
        out = run(model, io)
        assert out.feats.shape == (290, 8)
        assert bool(torch.isfinite(out.feats).all())


class _Plain(nn.Module):
    """The upsampling block as it is written down: unpool first, then everything else."""

    def __init__(self, block: SparseResBlock3d) -> None:
        super().__init__()
        self.block = block

    def forward(self, x: SparseTensor, t_emb: Tensor, index: Any) -> SparseTensor:
        x = unpool(x, index)
        b = self.block
        scale, shift = b.emb_layers(t_emb).chunk(2, dim=1)
        h = b.conv1(x.with_feats(nn.functional.silu(b.norm1(x.feats))))
        rows = h.batch
        h = h.with_feats(b.norm2(h.feats) * (1 + scale[rows]) + shift[rows])
        h = b.conv2(h.with_feats(nn.functional.silu(h.feats)))
        return h.with_feats(h.feats + b.skip_connection(x.feats))


def test_upsampling_late_equals_upsampling_first(io: dict[str, Tensor]) -> None:
    coarse, index = pool(voxels(io))
    generator = torch.Generator().manual_seed(3)
    x = coarse.with_feats(torch.randn(159, 24, generator=generator))
    t_emb = torch.randn(2, 10, generator=generator)
    block = SparseResBlock3d(24, 10, 7)
    nn.init.normal_(block.norm1.weight, generator=generator)
    with torch.no_grad():
        found, expected = block(x, t_emb, index), _Plain(block)(x, t_emb, index)
    assert_same(found.feats, expected.feats, 1e-6)
    assert torch.equal(found.coords, io["coords"])


def test_residual_block_takes_scale_before_shift(io: dict[str, Tensor]) -> None:
    block = SparseResBlock3d(8, 4, 8)
    with torch.no_grad():
        block.emb_layers[1].weight.zero_()
        block.emb_layers[1].bias[:8] = -1.0  # scale: the normalised features vanish
        block.emb_layers[1].bias[8:] = 0.0
        out = block(voxels(io), torch.zeros(2, 4))
        expected = io["feats"] + block.conv2.conv.bias
    assert_same(out.feats, expected, 1e-6)
    assert isinstance(block.norm2, LayerNorm32)
    assert block.norm2.weight is None
