"""DINOv2 weights from disk, in whichever layout they were published."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import torch
from pydantic import ValidationError
from torch import Tensor

from recast.core import files
from recast.core.errors import InputError
from recast.core.records import validation_error
from recast.core.torch_file import read_tensors, require_state
from recast.trellis.conditioning.dinov2 import Dinov2Config, Dinov2Encoder, to_hub

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

    Raises:
        InputError: a tensor that tells is missing or of another rank, or the sizes make no model.
    """

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
