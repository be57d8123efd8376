from __future__ import annotations

import pytest
import torch

from recast.trellis.flow_transformer import SparseStructureFlowConfig, SparseStructureFlowModel
from recast.trellis.layers import TrellisModel
from recast.trellis.vae import SparseStructureDecoder, SparseStructureEncoder
from support.trellis import golden_config, golden_tensors, official_keys

MODELS: dict[str, type[TrellisModel]] = {
    "ss_flow_img_dit_L_16l8_fp16": SparseStructureFlowModel,
    "ss_enc_conv3d_16l8_fp16": SparseStructureEncoder,
    "ss_dec_conv3d_16l8_fp16": SparseStructureDecoder,
}


def small_flow() -> SparseStructureFlowModel:
    return SparseStructureFlowModel(SparseStructureFlowConfig(**golden_config("ss_flow")["args"]))


@pytest.mark.parametrize("stem", list(MODELS))
def test_names_shapes_and_dtypes_equal_the_published_checkpoint(stem: str) -> None:
    published, model_class = official_keys()[stem], MODELS[stem]
    assert model_class.published_name == published["class"]
    with torch.device("meta"):
        model = model_class(model_class.config_class(**published["args"]))
    found = {
        name: {"shape": list(tensor.shape), "dtype": str(tensor.dtype).removeprefix("torch.")}
        for name, tensor in model.published_state().items()
    }
    assert found == published["state_dict"]
    assert model.device.type == "meta"
    assert sum(p.numel() for p in model.parameters()) == published["n_params"]


def test_torso_precision_can_be_changed_and_changed_back() -> None:
    model = small_flow()
    for dtype in (torch.bfloat16, torch.float32):
        model.set_torso_dtype(dtype)
        assert model.torso_dtype == dtype
        assert model.blocks[0].mlp.mlp[0].weight.dtype == dtype  # type: ignore[union-attr, index]
        assert model.out_layer.weight.dtype == torch.float32
        io = golden_tensors("ss_flow_io")
        assert model(io["x"], io["t"], io["cond"]).dtype == torch.float32


def test_half_weights_load_into_a_float_model() -> None:
    model = small_flow()
    model.load_published({name: t.half() for name, t in golden_tensors("ss_flow").items()})
    for name, tensor in model.published_state().items():
        assert tensor.dtype == torch.float32
        assert torch.equal(tensor, golden_tensors("ss_flow")[name].half().float())


def test_loading_is_strict() -> None:
    weights = golden_tensors("ss_flow")
    del weights["pos_emb"]
    with pytest.raises(RuntimeError, match="pos_emb"):
        small_flow().load_published(weights)


def test_one_seed_gives_one_set_of_initial_weights() -> None:
    a, b = small_flow(), small_flow()
    for model in (a, b):
        model.initialise(torch.Generator().manual_seed(3))
    for name, tensor in a.published_state().items():
        assert torch.equal(tensor, b.published_state()[name])
    b.initialise(torch.Generator().manual_seed(4))
    assert not torch.equal(a.input_layer.weight, b.input_layer.weight)


def test_a_model_made_without_memory_is_complete_once_loaded() -> None:
    with torch.device("meta"):
        model = small_flow()
    model.to_empty(device="cpu").load_published(golden_tensors("ss_flow"))
    io = golden_tensors("ss_flow_io")
    with torch.no_grad():
        assert torch.isfinite(model(io["x"], io["t"], io["cond"])).all()
