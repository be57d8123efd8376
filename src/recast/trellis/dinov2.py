"""The image encoder of the published checkpoints: DINOv2 ViT-L/14 with registers; tensors' names.

Torch hub keeps query, key and value of an attention in one matrix `qkv`, transformers in three.
Files of transformers hold the older names (`attention.attention.query`), its version 5 modules the
newer ones (`attention.q_proj`); both are read here, since either may come.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, cast

import torch
from pydantic import Field, PositiveFloat, ValidationError, model_validator
from torch import Tensor, nn

from recast.core import files
from recast.core.errors import InputError
from recast.core.records import validation_error
from recast.core.torch_file import read_tensors, require_state, state_faults
from recast.trellis.conditioning import normalise
from recast.trellis.layers import Depth, ModelConfig, Size, TrellisModel, final_norm

# Part of `qkv` that a matrix of transformers is.
_PARTS = {"query": 0, "key": 1, "value": 2, "q_proj": 0, "k_proj": 1, "v_proj": 2}

_TOP = {
    "embeddings.cls_token": "cls_token",
    "embeddings.mask_token": "mask_token",
    "embeddings.register_tokens": "register_tokens",
    "embeddings.position_embeddings": "pos_embed",
    "embeddings.patch_embeddings.projection.weight": "patch_embed.proj.weight",
    "embeddings.patch_embeddings.projection.bias": "patch_embed.proj.bias",
    "layernorm.weight": "norm.weight",
    "layernorm.bias": "norm.bias",
}

_LAYER = {
    "norm1": "norm1",
    "norm2": "norm2",
    "attention.output.dense": "attn.proj",
    "attention.o_proj": "attn.proj",
    "layer_scale1": "ls1",
    "layer_scale2": "ls2",
    "mlp.fc1": "mlp.fc1",
    "mlp.fc2": "mlp.fc2",
}

_IN_LAYER = re.compile(r"encoder\.layer\.(\d+)\.(.+)\.(weight|bias|lambda1)")
_IN_QKV = re.compile(r"attention\.(?:attention\.)?(query|key|value|q_proj|k_proj|v_proj)")


def hub_name(name: str) -> tuple[str, int | None]:
    """Name of a tensor of transformers in torch hub; 0, 1, 2 if it is the q, k or v part of it.
    Raises KeyError: no tensor of this model."""
    found = _IN_LAYER.fullmatch(name)
    if found is None:
        return _TOP[name], None
    index, inner, kind = found.groups()
    kind = "gamma" if kind == "lambda1" else kind
    qkv = _IN_QKV.fullmatch(inner)
    if qkv is not None:
        return f"blocks.{index}.attn.qkv.{kind}", _PARTS[qkv[1]]
    return f"blocks.{index}.{_LAYER[inner]}.{kind}", None


def to_hub(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Tensors under names of transformers to torch-hub names. Raises KeyError: with the name that
    is no tensor of this model, or whose query, key or value companion is missing."""
    hub: dict[str, Tensor] = {}
    parts: dict[str, dict[int, Tensor]] = {}
    for name, tensor in state.items():
        target, part = hub_name(name)
        if part is None:
            hub[target] = tensor
        else:
            parts.setdefault(target, {})[part] = tensor
    for target, found in parts.items():
        if len(found) < 3:
            raise KeyError(target)
        hub[target] = torch.cat([found[part] for part in range(3)])
    return hub


def from_hub(state: Mapping[str, Tensor], names: Iterable[str]) -> dict[str, Tensor]:
    """Torch-hub tensors under the given names of transformers, as views. Raises KeyError: a
    torch-hub name that one of `names` needs is missing."""
    found = {}
    for name in names:
        target, part = hub_name(name)
        tensor = state[target]
        found[name] = tensor if part is None else tensor.chunk(3)[part]
    return found


class Dinov2Config(ModelConfig):
    """Constructor arguments of torch hub's `DinoVisionTransformer`; defaults are those of ViT-L.

    Args:
        img_size: side in pixels of the images it was trained for.
        patch_size: side of a patch in pixels.
        embed_dim: channels of a token.
        depth: transformer blocks.
        num_heads: attention heads.
        mlp_ratio: hidden channels of the MLPs over `embed_dim`.
        num_register_tokens: tokens without a place in the image (Darcet et al. 2024).
        init_values: layer scale at the start.
        ffn_layer, block_chunks, interpolate_antialias, interpolate_offset: only what the models
            with registers were published with.
    """

    img_size: int = Field(default=518, ge=1, le=4096)
    patch_size: Size = 14
    embed_dim: Size = 1024
    depth: Depth = 24
    num_heads: Size = 16
    mlp_ratio: int = Field(default=4, ge=1, le=64)
    num_register_tokens: Size = 4
    init_values: PositiveFloat = 1.0
    ffn_layer: Literal["mlp"] = "mlp"
    block_chunks: Literal[0] = 0
    interpolate_antialias: Literal[True] = True
    interpolate_offset: float = Field(default=0.0, ge=0.0, le=0.0)

    @model_validator(mode="after")
    def _divides(self) -> Self:
        if self.embed_dim % self.num_heads:
            raise ValueError(
                f"embed_dim {self.embed_dim} does not divide into {self.num_heads} heads"
            )
        if self.img_size % self.patch_size:
            raise ValueError(
                f"img_size {self.img_size} does not divide into patches of {self.patch_size}"
            )
        return self


class Dinov2Encoder(TrellisModel):
    """DINOv2 with registers, through transformers, frozen and in float32.

    `published_state` and `load_published` speak torch hub's names, in which the backbone was
    published; `load_dinov2` reads either layout from disk.

    Source: Oquab et al. 2024 (DINOv2), Darcet et al. 2024 (registers).
    """

    published_name: ClassVar[str] = "DinoVisionTransformer"
    config_class: ClassVar[type[ModelConfig]] = Dinov2Config
    config: Dinov2Config

    def __init__(self, config: Dinov2Config) -> None:
        super().__init__(config)
        # transformers takes over a second to import, which only those who use this pay.
        from transformers import Dinov2WithRegistersConfig, Dinov2WithRegistersModel

        self.backbone: Any = Dinov2WithRegistersModel(
            Dinov2WithRegistersConfig(
                image_size=config.img_size,
                patch_size=config.patch_size,
                hidden_size=config.embed_dim,
                num_hidden_layers=config.depth,
                num_attention_heads=config.num_heads,
                mlp_ratio=config.mlp_ratio,
                num_register_tokens=config.num_register_tokens,
                layerscale_value=config.init_values,
                layer_norm_eps=1e-6,
            )
        )
        self.finish()
        self.requires_grad_(False)

    @torch.no_grad()
    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw initial weights; the real ones come from `load_dinov2`."""
        super().initialise(generator)
        embeddings = self.backbone.embeddings
        for token in ("position_embeddings", "cls_token", "register_tokens"):
            nn.init.trunc_normal_(getattr(embeddings, token), std=0.02, generator=generator)

    @property
    def image_size(self) -> int:
        """Side of the crops in pixels."""
        return self.config.img_size

    @property
    def channels(self) -> int:
        """Channels of a token."""
        return self.config.embed_dim

    def tokens_before_norm(self, images: Tensor) -> Tensor:
        """Output of the last block, before the model's final norm (torch hub's `x_prenorm`).

        Args:
            images: (B, 3, H, W) in [0, 1]; H and W multiples of the patch size. Position
                embeddings are interpolated (bicubic, antialiased) where they differ from
                `image_size`.

        Returns:
            (B, 1 + registers + patches, C): class token, registers, patches row by row.

        Raises:
            ValueError: H or W is no multiple of the patch size.
        """
        height, width = images.shape[-2:]
        patch = self.config.patch_size
        if height % patch or width % patch:
            raise ValueError(
                f"an image of {height}x{width} does not divide into patches of {patch} pixels"
            )
        # Not the model's own output: that has passed the final norm, with its learnt weights.
        embedded = self.backbone.embeddings(normalise(images))
        return cast(Tensor, self.backbone.encoder(embedded).last_hidden_state)

    def encode(self, images: Tensor) -> Tensor:
        """Context of the published flow models: `tokens_before_norm`, layer-normalised (eps 1e-5).

        From (B, 3, 518, 518) to (B, 1374, 1024) at the published size, without learnt weights.
        """
        return final_norm(self.tokens_before_norm(images))

    forward = encode

    def published_state(self) -> dict[str, Tensor]:
        """All tensors under torch hub's names; query, key and value joined, so copied."""
        return to_hub(self.backbone.state_dict())

    def load_published(self, state: dict[str, Tensor]) -> None:
        """Copy weights in from torch hub's names. Raises RuntimeError: a name is missing or
        unknown, or a shape differs, see `state_faults`."""
        own = self.backbone.state_dict()
        wanted = to_hub({name: tensor.to("meta") for name, tensor in own.items()})
        # Who reads the tensors looks for NaN, and can name the file.
        faults = state_faults({name: tensor.to("meta") for name, tensor in state.items()}, wanted)
        if any(faults.values()):
            raise RuntimeError(f"tensors do not match this network: {faults}")
        self.backbone.load_state_dict(from_hub(state, own), strict=True)


# Channels of an attention head in every published DINOv2; the weights alone do not tell.
_HEAD_CHANNELS = 64

_WEIGHTS = "DINOv2 weights"
_MEND = (
    "use torch hub's dinov2_vitl14_reg4_pretrain.pth or the folder of "
    "facebook/dinov2-with-registers-large"
)


def load_dinov2(path: str | Path, config: Dinov2Config | None = None) -> Dinov2Encoder:
    """Read a DINOv2 with registers; never asks the network.

    Args:
        path: folder with `config.json` and `model.safetensors` as transformers writes it; or a
            `.pth` of torch hub (only tensors are unpickled); or a `.safetensors` with torch-hub
            names. Beside a single file, `<stem>.json` may hold the arguments as
            `{"name": "DinoVisionTransformer", "args": {...}}`.
        config: arguments of a single file, where it has other heads than 64 channels wide, as all
            published ones have, and no arguments beside it; a folder always tells its own.

    Returns:
        Encoder in float32 on the CPU, frozen.

    Raises:
        InputError: missing or unreadable file, another model, a tensor missing, unknown, of
            another shape or not finite.
    """
    path = Path(path)
    if path.is_dir():
        state, told = _read_transformers_folder(path)
        path = path / "model.safetensors"
    else:
        if path.is_file() and path.suffix not in (".pth", ".pt", ".safetensors"):
            raise InputError(path, _WEIGHTS, f"have the unknown suffix {path.suffix!r}", _MEND)
        state = read_tensors(path, _WEIGHTS, _MEND)
        told = config or _config_beside(path) or config_from_shapes(state, path)
    # On the meta device nothing is drawn that the file would replace.
    with torch.device("meta"):
        encoder = Dinov2Encoder(told)
    require_state(path, state, encoder.published_state(), _MEND)
    encoder.to_empty(device="cpu").load_published(state)
    return encoder


def config_from_shapes(state: Mapping[str, Tensor], where: str | Path) -> Dinov2Config:
    """Arguments of a torch-hub state, with heads of 64 channels as all published models have.
    Raises InputError: a tensor that tells is missing or of another rank, or the sizes make no
    model."""

    def shape(name: str, rank: int) -> torch.Size:
        if name not in state:
            raise InputError(where, "tensor", f"{name!r} is missing", _MEND)
        if state[name].ndim != rank:
            found = tuple(state[name].shape)
            raise InputError(where, f"tensor {name!r}", f"has shape {found}", _MEND)
        return state[name].shape

    channels, _, patch, _ = shape("patch_embed.proj.weight", 4)
    blocks = {name.split(".")[1] for name in state if name.startswith("blocks.")}
    arguments = {
        "img_size": math.isqrt(max(shape("pos_embed", 3)[1] - 1, 0)) * patch,
        "patch_size": patch,
        "embed_dim": channels,
        "depth": len(blocks),
        "num_heads": max(channels // _HEAD_CHANNELS, 1),
        "mlp_ratio": shape("blocks.0.mlp.fc1.weight", 2)[0] // max(channels, 1),
        "num_register_tokens": shape("register_tokens", 3)[1],
    }
    return _validated(where, arguments)


def _read_transformers_folder(folder: Path) -> tuple[dict[str, Tensor], Dinov2Config]:
    file = folder / "config.json"
    record = files.read_json(file)
    kind = record.get("model_type") if isinstance(record, dict) else None
    if kind != "dinov2_with_registers":
        raise InputError(file, "model_type", f"is {kind!r}, not 'dinov2_with_registers'", _MEND)
    fixed = {"hidden_act": "gelu", "use_swiglu_ffn": False, "qkv_bias": True, "num_channels": 3}
    for name, value in (fixed | {"layer_norm_eps": 1e-6}).items():
        if record.get(name, value) != value:
            raise InputError(file, name, f"is {record[name]!r}, not {value!r}", _MEND)
    # Transformers leaves no default out when it writes, but older files lack what came later.
    names = {
        "img_size": ("image_size", 224),
        "patch_size": ("patch_size", 16),
        "embed_dim": ("hidden_size", 768),
        "depth": ("num_hidden_layers", 12),
        "num_heads": ("num_attention_heads", 12),
        "mlp_ratio": ("mlp_ratio", 4),
        "num_register_tokens": ("num_register_tokens", 4),
        "init_values": ("layerscale_value", 1.0),
    }
    config = _validated(file, {ours: record.get(*theirs) for ours, theirs in names.items()})
    weights = folder / "model.safetensors"
    try:
        return to_hub(read_tensors(weights, _WEIGHTS, _MEND)), config
    except KeyError as error:
        raise InputError(
            weights, "tensor", f"{error.args[0]!r} is unknown or incomplete", _MEND
        ) from None


def _config_beside(path: Path) -> Dinov2Config | None:
    file = path.with_suffix(".json")
    if not file.exists():
        return None
    record = files.read_json(file)
    if not isinstance(record, dict) or not isinstance(record.get("args"), dict):
        raise InputError(file, "args", "are missing", "write {'name': ..., 'args': {...}}")
    return _validated(file, record["args"])


def _validated(where: str | Path, arguments: Mapping[str, object]) -> Dinov2Config:
    try:
        return Dinov2Config.model_validate(arguments)
    except ValidationError as error:
        raise validation_error(where, error, _MEND) from None
