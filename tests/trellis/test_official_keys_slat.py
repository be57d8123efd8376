from __future__ import annotations

import pytest
import torch

from recast.trellis.model_files import build
from support.trellis import official_keys

STEMS = (
    "slat_flow_img_dit_L_64l8p2_fp16",
    "slat_enc_swin8_B_64l8_fp16",
    "slat_dec_gs_swin8_B_64l8gs32_fp16",
)


@pytest.mark.parametrize("stem", STEMS)
def test_names_shapes_and_types_equal_the_published_checkpoint(stem: str) -> None:
    official = official_keys()[stem]
    with torch.device("meta"):
        model = build(official["class"], official["args"], f"{stem}.json")
    state = model.published_state()
    found = {
        name: {"shape": list(value.shape), "dtype": str(value.dtype).removeprefix("torch.")}
        for name, value in state.items()
    }
    assert found == official["state_dict"]
    assert len(state) == official["n_tensors"]
    assert sum(value.numel() for value in model.parameters()) == official["n_params"]
