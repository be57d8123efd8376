"""Names of DINOv2's tensors: torch hub's, and those of transformers, old and new.

Torch hub keeps query, key and value of an attention in one matrix `qkv`, transformers in three.
Files of transformers hold the older names (`attention.attention.query`), its version 5 modules the
newer ones (`attention.q_proj`); both are read here, since either may come.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import torch
from torch import Tensor

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
    """Where a tensor of transformers is in the torch-hub layout.

    Returns:
        Name there, and 0, 1 or 2 where it is the query, key or value part of it, else None.

    Raises:
        KeyError: no tensor of this model.
    """
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
    """Tensors under names of transformers to torch-hub names.

    Raises:
        KeyError: with the name that is no tensor of this model, or whose query, key or value
            companion is missing.
    """
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
    """Torch-hub tensors under the given names of transformers, as views.

    Raises:
        KeyError: a torch-hub name that one of `names` needs is missing.
    """
    found = {}
    for name in names:
        target, part = hub_name(name)
        tensor = state[target]
        found[name] = tensor if part is None else tensor.chunk(3)[part]
    return found
