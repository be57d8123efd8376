"""The two departures of small models from the published classes: off unless asked for."""

from __future__ import annotations

import torch

from recast.trellis.models import build
from recast.trellis.models.slat_decoder_gs import SLatGaussianDecoder
from recast.trellis.sparse import SparseTensor
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
