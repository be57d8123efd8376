"""Networks that are put together of parts: their weights in one file or several, of either kind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from recast.errors import InputError
from recast.names import member
from recast.pretrained.folder import SPARE, WEIGHTS_FILE, check_tensors, first_line, quiet
from recast.storage import read_json
from recast.torch_file import read_tensors

_PYTORCH_FILE = "pytorch_model.bin"
_INDEX = ".index.json"


def has_weights(folder: Path) -> bool:
    """Whether a folder has a file that `weight_files` would find."""
    names = [name + end for name in (WEIGHTS_FILE, _PYTORCH_FILE) for end in ("", _INDEX)]
    return any((folder / name).is_file() for name in names)


def weight_files(folder: Path, mend: str) -> tuple[Path, ...]:
    """The files that hold the weights of a folder: safetensors if there are any, else PyTorch's.

    Args:
        mend: where the user finds them, for messages.

    Raises:
        InputError: there are none, or their index is no table of files in the folder.
    """
    for name in (WEIGHTS_FILE, _PYTORCH_FILE):
        if (folder / name).is_file():
            return (folder / name,)
        index = folder / (name + _INDEX)
        if index.is_file():
            found = read_json(index)
            table = found.get("weight_map") if isinstance(found, dict) else None
            if not isinstance(table, dict) or not all(isinstance(v, str) for v in table.values()):
                raise InputError(index, "weight_map", "is no table of file names", mend)
            names = sorted({*table.values()})
            return tuple(member(folder, one, index, "weight_map") for one in names)
    raise InputError(folder, f"{WEIGHTS_FILE} or {_PYTORCH_FILE}", "is missing", mend)


def read_weights(folder: Path, mend: str) -> dict[str, Tensor]:
    """All tensors of a folder's weights by name, on the CPU; no code in the files is run.

    Raises:
        InputError: see `weight_files` and `read_tensors`; or two files hold the same tensor.
    """
    state: dict[str, Tensor] = {}
    for path in weight_files(folder, mend):
        more = read_tensors(path, "weights", mend)
        twice = sorted(state.keys() & more.keys())
        if twice:
            raise InputError(path, twice[0], "is in another file too", mend)
        state |= more
    return state


def network_of(
    class_name: str, config: Any, state: Mapping[str, Tensor], where: Path, dtype: torch.dtype
) -> Any:
    """A network of transformers with these weights, on the CPU, ready to infer.

    Args:
        class_name: in transformers.
        config: configuration of that class.
        where: for messages.

    Raises:
        InputError: tensors are missing, of another shape or not finite, or the configuration asks
            for more layers or numbers than there are.
    """
    import transformers

    def refusal(problem: str) -> InputError:
        return InputError(where, "weights", problem, "download the files of this network again")

    layers = max(getattr(config, name, 0) for name in ("num_hidden_layers", "num_decoder_layers"))
    if layers > len(state):
        raise refusal(f"have {len(state)} tensors for {layers} layers")
    with quiet():
        try:
            network = getattr(transformers, class_name)
            with torch.device("meta"):  # takes no memory
                asked = sum(one.numel() for one in network(config).state_dict().values())
            stored = sum(math.prod(one.shape) for one in state.values())
            if asked > 2 * stored + SPARE:  # smaller differences are told by name below
                raise ValueError(f"the configuration asks for {asked} numbers, {stored} are stored")
            model, told = network.from_pretrained(
                None, config=config, state_dict=dict(state), output_loading_info=True,
                ignore_mismatched_sizes=True, dtype=dtype,
            )  # fmt: skip
        except Exception as error:  # transformers raises whatever its parts raise
            raise refusal(f"cannot be read ({first_line(error)})") from error
    absent, more = sorted(told["missing_keys"]), sorted(told["unexpected_keys"])
    if absent or more:
        raise refusal(f"lack {len(absent)} tensors and have {len(more)} more: {(absent + more)[0]}")
    check_tensors(model, told, refusal)
    return model.eval().requires_grad_(False)
