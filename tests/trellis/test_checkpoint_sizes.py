"""The published sizes to the byte, and what a new checkpoint of the small ones is."""

from __future__ import annotations

import pytest
import torch

from recast.trellis.checkpoint_sizes import OFFICIAL, SMALL, ModelSize, new_checkpoint
from recast.trellis.checkpoints import check_agreement
from recast.trellis.layers import TrellisModel
from recast.trellis.model_files import GENERATION_ROLES, build, file_bytes
from support.trellis import official_keys

# Sizes of the published files.
OFFICIAL_BYTES = {
    "ckpts/ss_flow_img_dit_L_16l8_fp16": 1_130_770_840,
    "ckpts/slat_flow_img_dit_L_64l8p2_fp16": 1_203_755_136,
    "ckpts/ss_enc_conv3d_16l8_fp16": 119_068_016,
    "ckpts/ss_dec_conv3d_16l8_fp16": 147_591_972,
    "ckpts/slat_enc_swin8_B_64l8_fp16": 173_242_816,
    "ckpts/slat_dec_gs_swin8_B_64l8gs32_fp16": 171_450_952,
}


def meta(size: ModelSize) -> TrellisModel:
    with torch.device("meta"):
        return build(size.name, size.args, size.stem)


@pytest.mark.parametrize("size", OFFICIAL.models.values(), ids=lambda size: size.name)
def test_the_published_files(size: ModelSize) -> None:
    keys = official_keys()[size.stem.removeprefix("ckpts/")]
    assert size.args == keys["args"]
    model = meta(size)
    specs = model.published_state()
    assert specs.keys() == keys["state_dict"].keys()
    for name, spec in specs.items():
        expected = keys["state_dict"][name]
        assert list(spec.shape) == expected["shape"], name
        assert spec.dtype == getattr(torch, expected["dtype"]), name
    assert file_bytes(specs) == OFFICIAL_BYTES[size.stem] == keys["official_file_bytes"]
    assert sum(p.numel() for p in model.parameters()) == keys["n_params"]


def test_the_published_backbone() -> None:
    assert OFFICIAL.backbone is not None
    keys = official_keys()["dinov2_vitl14_reg4_pretrain"]
    specs = meta(OFFICIAL.backbone).published_state()
    shapes = {name: list(spec.shape) for name, spec in specs.items()}
    assert shapes == {name: entry["shape"] for name, entry in keys["state_dict"].items()}


@pytest.mark.parametrize("sizes", [OFFICIAL, SMALL], ids=["official", "small"])
def test_the_models_fit_together(sizes, tmp_path) -> None:
    models = {role: meta(size) for role, size in sizes.models.items()}
    encoder = meta(sizes.backbone) if sizes.backbone else models["image_encoder"]
    check_agreement(tmp_path, sizes.record, models, encoder)


def test_the_small_models_are_small() -> None:
    roles = (*GENERATION_ROLES, "image_encoder")
    counts = {role: sum(p.numel() for p in meta(SMALL.models[role]).parameters()) for role in roles}
    assert 1_000_000 < sum(counts.values()) < 12_000_000, counts


def test_a_new_checkpoint_depends_on_its_seed_and_the_role_only() -> None:
    state = torch.random.get_rng_state()
    whole = new_checkpoint(SMALL, 3)
    role = "slat_flow_model"
    alone = new_checkpoint(SMALL, 3, roles=(role,), with_encoder=False)
    other = new_checkpoint(SMALL, 4, roles=(role,), with_encoder=False)
    assert torch.equal(torch.random.get_rng_state(), state)
    assert list(alone.models) == [role]
    assert alone.image_encoder is None
    assert whole.encoder is whole.models["image_encoder"]
    weight = "blocks.0.mlp.mlp.0.weight"
    states = [c.models[role].published_state() for c in (whole, alone, other)]
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])
    assert not torch.equal(states[0][weight], states[2][weight])
    assert all(bool(torch.isfinite(t).all()) for t in states[0].values())
    assert int(torch.count_nonzero(states[0]["out_layer.weight"])) == 0
