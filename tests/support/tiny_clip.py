"""Tiny CLIP and CLIP-FlanT5 with random weights, in folders as Hugging Face has them."""

from __future__ import annotations

import json
import string
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file
from tokenizers import Tokenizer, models, pre_tokenizers, processors
from torch import Tensor, nn
from transformers import (
    CLIPConfig,
    CLIPModel,
    CLIPTokenizer,
    CLIPVisionConfig,
    CLIPVisionModel,
    T5Config,
    T5ForConditionalGeneration,
)

CHARACTERS = string.ascii_letters + string.digits + string.punctuation
SIDE = 32
_TOWER = {
    "hidden_size": 16,
    "intermediate_size": 32,
    "num_hidden_layers": 3,
    "num_attention_heads": 2,
}


def write_tokenizer(folder: Path) -> CLIPTokenizer:
    """CLIP's tokenizer with single characters for tokens."""
    ends = "<|startoftext|>", "<|endoftext|>"
    tokens = [*CHARACTERS, *(f"{one}</w>" for one in CHARACTERS), *ends]
    (folder / "vocab.json").write_text(json.dumps({one: i for i, one in enumerate(tokens)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    tokenizer = CLIPTokenizer(str(folder / "vocab.json"), str(folder / "merges.txt"))
    tokenizer.save_pretrained(folder)
    return tokenizer


def write_processor(folder: Path, side: int = SIDE) -> None:
    """As openai/clip-vit-large-patch14 has it."""
    told = {
        "crop_size": side,
        "do_center_crop": True,
        "do_normalize": True,
        "do_resize": True,
        "feature_extractor_type": "CLIPFeatureExtractor",
        "resample": 3,
        "size": side,
        "image_mean": [0.48145466, 0.4578275, 0.40821073],
        "image_std": [0.26862954, 0.26130258, 0.27577711],
    }
    (folder / "preprocessor_config.json").write_text(json.dumps(told))


def write_clip(folder: Path, **sizes: Any) -> CLIPModel:
    """Both towers of CLIP, its tokenizer and its processor; `sizes` are of CLIPConfig."""
    folder.mkdir(parents=True, exist_ok=True)
    count = len(write_tokenizer(folder))
    sizes = sizes or {
        "vision_config": {**_TOWER, "image_size": SIDE, "patch_size": 8},
        "text_config": {**_TOWER, "vocab_size": count, "eos_token_id": count - 1},
        "projection_dim": 8,
    }
    torch.manual_seed(0)
    config = CLIPConfig(**sizes)
    model = CLIPModel(config).eval()
    model.save_pretrained(folder)
    write_processor(folder, config.vision_config.image_size)
    return model


@dataclass(frozen=True)
class TinyClipT5:
    """What `write_clip_t5` wrote.

    Attributes:
        projector: from patches to the width of T5.
        tokenizer: has fewer tokens than T5 has embeddings.
        settings: of config.json.
        state: of the weights.
    """

    language: T5ForConditionalGeneration
    vision: CLIPVisionModel
    projector: nn.Sequential
    tokenizer: Tokenizer
    settings: dict[str, Any]
    state: dict[str, Tensor]


def write_clip_t5(folder: Path) -> TinyClipT5:
    """The folder that `load_clip_t5` reads, named as the authors' code names tensors."""
    torch.manual_seed(1)
    (folder / "vision_tower").mkdir(parents=True)
    tokenizer = _t5_tokenizer()
    tokenizer.save(str(folder / "tokenizer.json"))
    vision_config = CLIPVisionConfig(**_TOWER, image_size=SIDE, patch_size=16)
    vision = CLIPVisionModel(vision_config).eval()
    vision_config.save_pretrained(folder / "vision_tower")
    write_processor(folder / "vision_tower")
    sizes = {
        "vocab_size": tokenizer.get_vocab_size() + 12,
        "d_model": 24,
        "d_kv": 8,
        "d_ff": 32,
        "num_layers": 2,
        "num_decoder_layers": 2,
        "num_heads": 3,
        "feed_forward_proj": "gated-gelu",
        "tie_word_embeddings": False,
        "decoder_start_token_id": 0,
    }
    language = T5ForConditionalGeneration(T5Config(**sizes)).eval()
    for parameter in language.parameters():  # far from uniform answers
        nn.init.normal_(parameter, 0.0, 0.5)
    language.lm_head.weight = nn.Parameter(torch.randn_like(language.shared.weight))
    projector = nn.Sequential(nn.Linear(16, 24), nn.GELU(), nn.Linear(24, 24))
    settings = {
        **sizes,
        "model_type": "t5",
        "mm_vision_tower": "openai/clip-vit-large-patch14-336",
        "mm_projector_type": "mlp2x_gelu",
        "mm_hidden_size": 16,
        "mm_vision_select_layer": -2,
        "mm_vision_select_feature": "patch",
        "mm_use_im_start_end": False,
        "mm_use_im_patch_token": False,
        "image_aspect_ratio": "pad",
        "torch_dtype": "bfloat16",
    }
    (folder / "config.json").write_text(json.dumps(settings))
    own = {name: one for name, one in language.state_dict().items() if "embed_tokens" not in name}
    state = {
        **{name: one.detach().clone() for name, one in own.items()},
        **{
            f"vision_tower.vision_tower.vision_model.{name}": one.clone()
            for name, one in vision.state_dict().items()
        },
        **{f"mm_projector.{name}": one.clone() for name, one in projector.state_dict().items()},
    }
    save_file(state, folder / "model.safetensors")
    return TinyClipT5(language, vision, projector, tokenizer, settings, state)


def _t5_tokenizer() -> Tokenizer:
    """Single characters and " Yes"; every text gets T5's end token."""
    pieces = [("<pad>", 0.0), ("</s>", 0.0), ("<unk>", 0.0), ("▁", -2.0), ("▁Yes", -3.0)]
    pieces += [(one, -4.0) for one in CHARACTERS]
    tokenizer = Tokenizer(models.Unigram(pieces, unk_id=2))
    tokenizer.pre_tokenizer = pre_tokenizers.Metaspace()
    tokenizer.post_processor = processors.TemplateProcessing(
        single="$A </s>", special_tokens=[("</s>", 1)]
    )
    tokenizer.add_special_tokens(["<pad>", "</s>", "<unk>"])
    return tokenizer
