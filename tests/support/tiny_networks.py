"""Tiny Grounding DINO and SAM with random weights, in folders as Hugging Face has them."""

from __future__ import annotations

import json
from pathlib import Path

import torch

WORDS = (
    "[PAD]",
    "[UNK]",
    "[CLS]",
    "[SEP]",
    "[MASK]",
    ".",
    "a",
    "car",
    "van",
    "truck",
    "bus",
    "vehicle",
)


def write_tiny_networks(folder: Path) -> Path:
    """Write `folder/grounding-dino` (0.4 M parameters) and `folder/sam` (0.1 M)."""
    generator_state = torch.get_rng_state()
    torch.manual_seed(3)
    _write_grounding_dino(folder / "grounding-dino")
    _write_sam(folder / "sam")
    torch.set_rng_state(generator_state)
    return folder


def _write_grounding_dino(folder: Path) -> None:
    from transformers import (
        BertConfig,
        BertTokenizer,
        GroundingDinoConfig,
        GroundingDinoForObjectDetection,
        GroundingDinoImageProcessor,
        GroundingDinoProcessor,
        SwinConfig,
    )

    folder.mkdir(parents=True)
    backbone = SwinConfig(
        image_size=64,
        embed_dim=16,
        depths=[1, 1, 1, 1],
        num_heads=[1, 1, 2, 2],
        window_size=4,
        out_indices=[2, 3, 4],
    )
    text = BertConfig(
        vocab_size=len(WORDS),
        hidden_size=32,
        num_hidden_layers=1,
        num_attention_heads=2,
        intermediate_size=32,
        max_position_embeddings=64,
    )
    config = GroundingDinoConfig(
        backbone_config=backbone,
        text_config=text,
        d_model=32,
        encoder_layers=1,
        decoder_layers=2,
        encoder_attention_heads=2,
        decoder_attention_heads=2,
        encoder_ffn_dim=32,
        decoder_ffn_dim=32,
        num_queries=12,
        max_text_len=32,
    )
    GroundingDinoForObjectDetection(config).save_pretrained(folder)
    (folder / "vocab.txt").write_text("\n".join(WORDS))
    image_processor = GroundingDinoImageProcessor(size={"shortest_edge": 64, "longest_edge": 96})
    tokenizer = BertTokenizer(vocab=str(folder / "vocab.txt"))
    GroundingDinoProcessor(image_processor, tokenizer).save_pretrained(folder)
    _as_published(folder)


def _write_sam(folder: Path) -> None:
    from transformers import SamConfig, SamImageProcessor, SamModel, SamProcessor

    shared = {"hidden_size": 32, "image_size": 64, "patch_size": 16}
    config = SamConfig(
        vision_config={
            **shared,
            "output_channels": 32,
            "num_hidden_layers": 1,
            "num_attention_heads": 2,
            "window_size": 2,
            "global_attn_indexes": [0],
            "num_pos_feats": 16,
            "mlp_dim": 32,
            "initializer_range": 0.5,
        },
        prompt_encoder_config={**shared, "mask_input_channels": 4},
        mask_decoder_config={
            "hidden_size": 32,
            "mlp_dim": 32,
            "num_attention_heads": 2,
            "num_hidden_layers": 1,
            "iou_head_hidden_dim": 16,
            "iou_head_depth": 2,
        },
    )
    SamModel(config).save_pretrained(folder)
    processor = SamImageProcessor(size={"longest_edge": 64}, pad_size={"height": 64, "width": 64})
    SamProcessor(processor).save_pretrained(folder)
    _as_published(folder)


def _as_published(folder: Path) -> None:
    """The published repositories have the image processor's settings in a file of their own."""
    together = folder / "processor_config.json"
    settings = json.loads(together.read_text())
    together.unlink()
    alone = {**settings["image_processor"], "processor_class": settings["processor_class"]}
    (folder / "preprocessor_config.json").write_text(json.dumps(alone))
