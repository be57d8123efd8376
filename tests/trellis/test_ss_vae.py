from __future__ import annotations

import copy
from typing import Any

import pytest
import torch

from recast.trellis.layers import Posterior
from recast.trellis.vae import (
    SparseStructureDecoder,
    SparseStructureDecoderConfig,
    SparseStructureEncoder,
    SparseStructureEncoderConfig,
    occupied_voxels,
    pixel_shuffle_3d,
)
from support.trellis import assert_same, golden_config, golden_tensors, half_bound


def golden_encoder() -> SparseStructureEncoder:
    model = SparseStructureEncoder(SparseStructureEncoderConfig(**golden_config("ss_enc")["args"]))
    model.load_published(golden_tensors("ss_enc"))
    return model


def golden_decoder(**changes: Any) -> SparseStructureDecoder:
    config = SparseStructureDecoderConfig(**golden_config("ss_dec")["args"] | changes)
    model = SparseStructureDecoder(config)
    model.load_published(golden_tensors("ss_dec"))
    return model


@torch.no_grad()
def test_encoder_equals_the_published_code() -> None:
    io = golden_tensors("ss_enc_io")
    posterior = golden_encoder()(io["ss"])
    assert_same(posterior.mean, io["mean"])
    assert_same(posterior.logvar, io["logvar"])
    assert_same(posterior.mean, io["z"])


@torch.no_grad()
def test_decoder_equals_the_published_code_and_gives_its_voxels() -> None:
    io = golden_tensors("ss_dec_io")
    logits = golden_decoder()(io["z"])
    assert_same(logits, io["logits"])
    voxels = occupied_voxels(logits)
    assert voxels.dtype == torch.int32
    assert torch.equal(voxels, io["coords"])


@torch.no_grad()
def test_half_torso_of_the_decoder_stays_near_the_published_one() -> None:
    model, io = golden_decoder(use_fp16=True), golden_tensors("ss_dec_io")
    logits = model(io["z"])
    assert logits.dtype == torch.float32
    assert_same(logits, io["logits"], half_bound(model))
    assert_same(logits, io["logits_fp16_torso"], 2 * half_bound(model))
    assert not torch.equal(logits, golden_decoder()(io["z"]))


def test_half_torso_converts_convolutions_of_blocks_and_middle_only() -> None:
    for name, tensor in golden_decoder(use_fp16=True).published_state().items():
        half = name.split(".")[0] in ("blocks", "middle_block") and "norm" not in name
        assert tensor.dtype == (torch.float16 if half else torch.float32), name


def test_pixel_shuffle_puts_channels_at_their_offsets() -> None:
    x = torch.arange(16 * 2 * 3 * 4, dtype=torch.float32).reshape(1, 16, 2, 3, 4)
    out = pixel_shuffle_3d(x)
    assert out.shape == (1, 2, 4, 6, 8)
    for dx, dy, dz in ((0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 0)):
        found = out[0, 1, dx::2, dy::2, dz::2]
        assert torch.equal(found, x[0, 8 + 4 * dx + 2 * dy + dz])


def test_checkpointing_gives_the_same_gradients() -> None:
    plain, z = golden_decoder(), golden_tensors("ss_dec_io")["z"]
    saving = copy.deepcopy(plain)
    saving.checkpointing = True
    outputs = [model(z) for model in (plain, saving)]
    assert torch.equal(outputs[0], outputs[1])
    for out in outputs:
        out.square().mean().backward()
    for a, b in zip(plain.parameters(), saving.parameters(), strict=True):
        assert a.grad is not None
        assert b.grad is not None
        assert torch.equal(a.grad, b.grad)


def test_residual_blocks_of_a_new_model_are_the_identity() -> None:
    model = SparseStructureDecoder(SparseStructureDecoderConfig(**golden_config("ss_dec")["args"]))
    h = torch.randn(1, 16, 4, 4, 4, generator=torch.Generator().manual_seed(0))
    assert torch.equal(model.middle_block(h), h)


def test_posterior_samples_its_mean_and_spread() -> None:
    shape = (1, 2, 20, 20, 20)
    posterior = Posterior(torch.full(shape, 3.0), torch.full(shape, 2 * torch.tensor(0.5).log()))
    drawn = posterior.sample(torch.Generator().manual_seed(1))
    assert float(drawn.mean()) == pytest.approx(3.0, abs=0.02)
    assert float(drawn.std()) == pytest.approx(0.5, abs=0.02)
    assert torch.equal(drawn, posterior.sample(torch.Generator().manual_seed(1)))
