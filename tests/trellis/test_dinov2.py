"""DINOv2 with registers against the published network, and its names against the published file."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch
from pydantic import ValidationError

from recast.trellis.conditioning import ImageEncoder
from recast.trellis.dinov2 import Dinov2Config, Dinov2Encoder, from_hub, hub_name, to_hub
from support.trellis import assert_same, golden_config, golden_tensors, official_keys

CONFIG = Dinov2Config(**golden_config("dinov2_tiny")["args"])


@pytest.fixture(scope="module")
def encoder() -> Dinov2Encoder:
    made = Dinov2Encoder(CONFIG)
    made.load_published(golden_tensors("dinov2_tiny"))
    return made


@pytest.mark.parametrize("size", ["", "70"])
def test_tokens_and_condition(encoder: Dinov2Encoder, size: str):
    """At the size it was made for, and at another, where positions are interpolated."""
    golden = golden_tensors("dinov2_tiny_io")
    image = golden[f"image{size}"]
    assert_same(encoder.tokens_before_norm(image), golden[f"x_prenorm{size}"])
    assert_same(encoder.encode(image), golden[f"cond{size}"])


def test_published_state_gives_back_what_was_loaded(encoder: Dinov2Encoder):
    golden, found = golden_tensors("dinov2_tiny"), encoder.published_state()
    assert found.keys() == golden.keys()
    for name, tensor in golden.items():
        assert torch.equal(found[name], tensor), name


def test_official_names_shapes_and_dtypes():
    official = official_keys()["dinov2_vitl14_reg4_pretrain"]
    with torch.device("meta"):
        state = Dinov2Encoder(Dinov2Config(**official["args"])).published_state()
    found = {
        name: {"shape": list(tensor.shape), "dtype": str(tensor.dtype).removeprefix("torch.")}
        for name, tensor in state.items()
    }
    assert found == official["state_dict"]
    assert sum(tensor.numel() for tensor in state.values()) == official["n_params"]


def test_defaults_are_the_published_arguments():
    official = official_keys()["dinov2_vitl14_reg4_pretrain"]
    assert Dinov2Config(**official["args"]) == Dinov2Config()
    assert Dinov2Encoder.published_name == official["class"]


def test_older_and_newer_names_of_transformers_agree():
    """All tensors of a block, under both, from one torch-hub block and back."""
    hub = golden_tensors("dinov2_tiny")
    tops = [name for name in _transformers_names("q_proj", "o_proj") if "layer." not in name]
    for query, out in (("q_proj", "o_proj"), ("attention.query", "output.dense")):
        names = _transformers_names(query, out)
        assert len(names) == len(tops) + 2 * 18
        assert {hub_name(name)[0] for name in names} == hub.keys()
        for name, tensor in to_hub(from_hub(hub, names)).items():
            assert torch.equal(tensor, hub[name]), name


def _transformers_names(query: str, out: str) -> list[str]:
    tops = ["cls_token", "mask_token", "register_tokens", "position_embeddings"]
    names = [f"embeddings.{name}" for name in tops]
    keys = [query.replace("q_", f"{k[0]}_").replace("query", k) for k in ("query", "key", "value")]
    layers = [f"attention.{key}" for key in keys] + [f"attention.{out}"]
    layers += ["norm1", "norm2", "mlp.fc1", "mlp.fc2"]
    for kind in ("weight", "bias"):
        names += [f"embeddings.patch_embeddings.projection.{kind}", f"layernorm.{kind}"]
        names += [f"encoder.layer.{i}.{layer}.{kind}" for i in range(2) for layer in layers]
    return names + [f"encoder.layer.{i}.layer_scale{n}.lambda1" for i in range(2) for n in (1, 2)]


def test_incomplete_attention_is_not_joined():
    names = [
        name for name in _transformers_names("q_proj", "o_proj") if "1.attention.k" not in name
    ]
    with pytest.raises(KeyError, match=r"blocks\.1\.attn\.qkv"):
        to_hub(from_hub(golden_tensors("dinov2_tiny"), names))


@pytest.mark.parametrize("fault", ["missing", "unknown", "shape"])
def test_load_is_strict(encoder: Dinov2Encoder, fault: str):
    state = golden_tensors("dinov2_tiny")
    name = "blocks.1.attn.qkv.bias"
    if fault == "missing":
        del state[name]
    elif fault == "unknown":
        name = "head.weight"
        state[name] = torch.zeros(3)
    else:
        state[name] = torch.zeros(2)
    with pytest.raises(RuntimeError, match=name):
        encoder.load_published(state)


def test_frozen_and_behind_the_seam(encoder: Dinov2Encoder):
    assert isinstance(encoder, ImageEncoder)
    assert (encoder.image_size, encoder.channels) == (56, 48)
    assert not any(parameter.requires_grad for parameter in encoder.parameters())


def test_initial_weights_follow_the_generator():
    def drawn(seed: int) -> torch.Tensor:
        encoder = Dinov2Encoder(CONFIG)
        encoder.initialise(torch.Generator().manual_seed(seed))
        return encoder.encode(golden_tensors("dinov2_tiny_io")["image"])

    assert torch.equal(drawn(1), drawn(1))
    assert not torch.equal(drawn(1), drawn(2))


def test_image_that_does_not_divide_into_patches(encoder: Dinov2Encoder):
    with pytest.raises(ValueError, match="57x56 does not divide into patches of 14"):
        encoder.encode(torch.zeros(1, 3, 57, 56))


@pytest.mark.parametrize(
    "arguments",
    [
        {"ffn_layer": "swiglufused"},
        {"interpolate_offset": 0.1},
        {"interpolate_antialias": False},
        {"block_chunks": 4},
        {"num_register_tokens": 0},
        {"embed_dim": 1000},
        {"img_size": 512},
        {"unheard_of": 1},
    ],
)
def test_other_dinov2_are_refused(arguments: dict[str, object]):
    with pytest.raises(ValidationError):
        Dinov2Config(**arguments)


def test_importing_leaves_transformers_alone():
    code = "import sys, recast.trellis.conditioning; print('transformers' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
