"""The departures of small models from the published classes: off unless asked for."""

from __future__ import annotations

import torch

from recast.trellis.checkpoint_sizes import SMALL, new_checkpoint
from recast.trellis.model_files import build
from recast.trellis.sparse import SparseTensor
from recast.trellis.vae import SLatGaussianDecoder
from support.trellis import golden_config, golden_tensors


def _built(name: str, **changes: object) -> torch.nn.Module:
    config = golden_config(name)
    return build(config["name"], {**config["args"], **changes}, name)


def test_the_summary_token_modulates() -> None:
    for name in ("ss_flow", "slat_flow"):
        plain, pooled = _built(name), _built(name, pool_cond=True)
        extra = set(pooled.state_dict()) - set(plain.state_dict())
        assert extra == {"cond_pool.weight", "cond_pool.bias"}
    pooled.load_state_dict(golden_tensors("slat_flow"), strict=False)
    case = golden_tensors("slat_flow_io")
    x = SparseTensor(case["coords"], case["feats"], 2)
    with torch.no_grad():
        pooled.cond_pool.weight.zero_()
        torch.testing.assert_close(
            pooled(x, case["t"], case["cond"]).feats, case["out"], rtol=1e-5, atol=1e-5
        )
        pooled.cond_pool.weight.normal_(generator=torch.Generator().manual_seed(0))
        changed = pooled(x, case["t"], case["cond"]).feats
    assert float((changed - case["out"]).abs().max()) > 0.01


def test_the_base_colour_reaches_every_gaussian_of_its_voxel() -> None:
    representation = golden_config("slat_dec_gs")["args"]["representation_config"]
    decoder = _built("slat_dec_gs", representation_config={**representation, "base_color": True})
    assert isinstance(decoder, SLatGaussianDecoder)
    decoder.load_state_dict(golden_tensors("slat_dec_gs"), strict=False)
    case = golden_tensors("slat_dec_gs_io")
    x = SparseTensor(case["coords"], case["feats"], 2)
    assert decoder.base_color is not None
    with torch.no_grad():
        decoder.base_color.bias.zero_()
        decoder.base_color.weight.zero_()
        decoder.base_color.weight[1, 0] = 0.5  # green from the first latent channel
        raw = decoder(x).feats - case["raw"]
    g = representation["num_gaussians"]
    added = raw[:, 3 * g : 6 * g].unflatten(1, (g, 3))
    expected = 2.0 * case["feats"][:, :1].expand(-1, g)
    torch.testing.assert_close(added[..., 1], expected, rtol=1e-4, atol=1e-4)
    assert float(added[..., [0, 2]].abs().max()) < 1e-4
    assert float(raw[:, : 3 * g].abs().max()) < 1e-4
    assert float(raw[:, 6 * g :].abs().max()) < 1e-4


def test_the_skip_hands_features_to_the_latent() -> None:
    plain, skipping = _built("slat_enc"), _built("slat_enc", skip_latent=True)
    assert set(skipping.state_dict()) - set(plain.state_dict()) == {
        "skip_latent.weight",
        "skip_latent.bias",
    }
    skipping.load_state_dict(golden_tensors("slat_enc"), strict=False)
    case = golden_tensors("slat_enc_io")
    x = SparseTensor(case["coords"], case["feats"], 2)
    with torch.no_grad():
        posterior = skipping(x)
    added = posterior.mean.feats - case["mean"]
    torch.testing.assert_close(added, case["feats"][:, :8], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(posterior.logvar.feats, case["logvar"], rtol=1e-4, atol=1e-4)


def test_colours_survive_both_skips_from_the_start() -> None:
    """A new small encoder and decoder give every voxel its mean colour before any training."""
    made = new_checkpoint(SMALL, 0, roles=("slat_encoder", "slat_decoder_gs"), with_encoder=False)
    encoder, decoder = made.models["slat_encoder"], made.models["slat_decoder_gs"]
    coords = torch.tensor([[3, 4, 5], [3, 4, 6], [20, 9, 1]])
    features = torch.zeros(3, 17)
    features[:, :3] = torch.tensor([[0.8, -0.4, 0.1], [-1.0, -1.0, -1.0], [0.2, 0.9, -0.7]])
    with torch.no_grad():
        for layer in (encoder.out_layer, decoder.out_layer):
            layer.weight.zero_()
        latent = encoder(SparseTensor.stack([coords], [features])).mean
        (gaussians,) = decoder.gaussians(decoder(latent))
    colour = 0.28209479177387814 * gaussians.sh[:, 0] + 0.5
    expected = ((features[:, :3] + 1) / 2).repeat_interleave(8, dim=0)
    torch.testing.assert_close(colour, expected, rtol=1e-4, atol=1e-4)
