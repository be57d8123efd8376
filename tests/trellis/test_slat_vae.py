from __future__ import annotations

import copy
from typing import Any

import pytest
import torch
from tests.trellis.sparse_samples import one_sample
from torch import Tensor

from recast.trellis.sparse import SparseTensor
from recast.trellis.vae import (
    SLatEncoder,
    SLatEncoderConfig,
    SLatGaussianDecoder,
    SLatGaussianDecoderConfig,
    SLatTransformer,
)
from support.trellis import assert_same, golden_config, golden_tensors, half_bound


def encoder(**changes: Any) -> SLatEncoder:
    model = SLatEncoder(SLatEncoderConfig(**golden_config("slat_enc")["args"] | changes))
    model.load_published(golden_tensors("slat_enc"))
    return model


def decoder(**changes: Any) -> SLatGaussianDecoder:
    args = golden_config("slat_dec_gs")["args"] | changes
    model = SLatGaussianDecoder(SLatGaussianDecoderConfig(**args))
    model.load_published(golden_tensors("slat_dec_gs"))
    return model


def voxels(io: dict[str, Tensor]) -> SparseTensor:
    return SparseTensor(io["coords"], io["feats"], 2)


@torch.no_grad()
def test_encoder_equals_the_published_code() -> None:
    io = golden_tensors("slat_enc_io")
    posterior = encoder()(voxels(io))
    assert_same(posterior.mean.feats, io["mean"])
    assert_same(posterior.logvar.feats, io["logvar"])
    assert_same(posterior.mean.feats, io["z"])
    assert torch.equal(posterior.mean.coords, io["coords"])


def test_samples_follow_the_posterior_and_the_generator() -> None:
    model = encoder()
    posterior = model(voxels(golden_tensors("slat_enc_io")))
    draws = [posterior.sample(torch.Generator().manual_seed(seed)).feats for seed in (0, 0, 1)]
    assert torch.equal(draws[0], draws[1])
    assert not torch.equal(draws[0], draws[2])
    spread = torch.exp(0.5 * posterior.logvar.feats)
    deviations = ((draws[0] - posterior.mean.feats) / spread).detach()
    assert abs(float(deviations.mean())) < 0.1
    assert 0.94 < float(deviations.std()) < 1.06
    draws[0].square().sum().backward()
    assert model.out_layer.weight.grad is not None
    assert bool((model.out_layer.weight.grad != 0).all())  # rows of mean and of logvar


@torch.no_grad()
def test_decoder_equals_the_published_code() -> None:
    io, model = golden_tensors("slat_dec_gs_io"), decoder()
    raw = model(voxels(io))
    assert_same(raw.feats, io["raw"])
    for i, found in enumerate(model.gaussians(raw)):
        found.validate()
        assert_same(found.means, io[f"g{i}_xyz"])
        assert_same(found.log_scales.exp(), io[f"g{i}_scaling"])
        assert_same(found.quats, io[f"g{i}_rotation"])
        assert_same(found.logit_opacities.sigmoid()[:, None], io[f"g{i}_opacity"])
        assert_same(found.sh, io[f"g{i}_features"])


def test_a_new_decoder_computes_the_published_perturbation() -> None:
    args = golden_config("slat_dec_gs")["args"]
    model = SLatGaussianDecoder(SLatGaussianDecoderConfig(**args))
    expected = golden_tensors("slat_dec_gs_io")["offset_perturbation"]
    assert_same(model.published_state()["offset_perturbation"], expected, 1e-6)
    assert "offset_perturbation" not in dict(model.named_parameters())


def test_a_stored_perturbation_is_taken_over() -> None:
    model = decoder()
    other = golden_tensors("slat_dec_gs")
    other["offset_perturbation"] = torch.zeros(8, 3)
    model.load_published(other)
    (found,) = model.gaussians(
        SparseTensor(torch.tensor([[0, 3, 4, 5]], dtype=torch.int32), torch.zeros(1, 112), 1)
    )
    centre = (torch.tensor([3.0, 4.0, 5.0]) + 0.5) / 16 - 0.5
    assert torch.allclose(found.means, centre.expand(8, 3))


def test_weights_made_on_the_meta_device_can_be_initialised() -> None:
    args = golden_config("slat_dec_gs")["args"]
    with torch.device("meta"):
        model = SLatGaussianDecoder(SLatGaussianDecoderConfig(**args))
    model.to_empty(device="cpu")
    model.initialise(torch.Generator().manual_seed(0))
    assert_same(
        model.offset_perturbation, golden_tensors("slat_dec_gs_io")["offset_perturbation"], 1e-6
    )
    assert not model.out_layer.weight.any()
    assert model.blocks[0].attn.to_qkv.weight.any()


@pytest.mark.parametrize(("build", "name"), [(encoder, "slat_enc"), (decoder, "slat_dec_gs")])
def test_half_torso_stays_near_float32(build: Any, name: str) -> None:
    x = voxels(golden_tensors(f"{name}_io"))
    with torch.no_grad():
        model = build(use_fp16=True)
        full, half = build().outputs(x), model.outputs(x)
    assert half.dtype == torch.float32
    assert not torch.equal(full, half)
    assert_same(half, full, half_bound(model))
    for key, tensor in model.published_state().items():
        half_expected = key.startswith("blocks.")
        assert tensor.dtype == (torch.float16 if half_expected else torch.float32), key


@torch.no_grad()
@pytest.mark.parametrize("place", [0, 1, 2])
def test_an_empty_sample_gives_no_gaussians_and_changes_nothing(place: int) -> None:
    io, model = golden_tensors("slat_dec_gs_io"), decoder()
    coords = io["coords"].clone()
    coords[:, 0] += (coords[:, 0] >= place).int()
    raw = model(SparseTensor(coords, io["feats"], 3))
    assert_same(raw.feats, io["raw"])
    found = model.gaussians(raw)
    assert len(found) == 3
    assert len(found[place]) == 0
    found[place].validate()
    others = [found[i] for i in range(3) if i != place]
    assert_same(others[0].means, io["g0_xyz"])
    assert_same(others[1].means, io["g1_xyz"])


def test_no_voxels_at_all() -> None:
    io, model = golden_tensors("slat_dec_gs_io"), decoder()
    raw = model(SparseTensor(io["coords"][:0], io["feats"][:0], 2))
    assert [len(gaussians) for gaussians in model.gaussians(raw)] == [0, 0]


@pytest.mark.parametrize(("build", "name"), [(encoder, "slat_enc"), (decoder, "slat_dec_gs")])
def test_a_batch_of_two_equals_the_two_alone(build: Any, name: str) -> None:
    model: SLatTransformer = build()
    x = voxels(golden_tensors(f"{name}_io"))
    with torch.no_grad():
        both = x.with_feats(model.outputs(x))
        for i in range(2):
            assert_same(one_sample(both, i).feats, model.outputs(one_sample(x, i)), 2e-6)


def test_checkpointing_gives_the_same_gradients() -> None:
    io, plain = golden_tensors("slat_dec_gs_io"), decoder()
    saving = copy.deepcopy(plain)
    saving.checkpointing = True
    calls: list[int] = []
    saving.blocks[1].register_forward_pre_hook(lambda *_: calls.append(1))
    for model in (plain, saving):
        model(voxels(io)).feats.square().mean().backward()
    assert len(calls) == 2  # once forward, once again for the backward pass
    for a, b in zip(plain.parameters(), saving.parameters(), strict=True):
        assert a.grad is not None
        assert b.grad is not None
        assert torch.equal(a.grad, b.grad)
