"""Files of `torch.save`, of which nothing but tensors and plain values is ever unpickled."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import torch

from recast.errors import InputError


def read_torch_file(path: Path, mend: str) -> Any:
    """What the file holds, its tensors on the CPU.

    Args:
        mend: what the user can do about a damaged file.

    Raises:
        InputError: the file is missing or damaged, or holds other objects than tensors, plain
            values, lists and dictionaries; no code in it is run.
    """
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except (FileNotFoundError, IsADirectoryError, PermissionError) as error:
        problem = (error.strerror or "cannot be read").lower()
        raise InputError(path, "file", problem, "check the path") from None
    except Exception as error:  # the unpickler lets through whatever broken bytes lead to
        # PyTorch's own text is a page long and tells the reader to trust the file.
        refused = re.search(r"nsupported (?:global: |class )?(?:GLOBAL )?([\w.]+)", str(error))
        if refused is not None:
            raise InputError(
                path, "file", f"holds {refused[1]}, which is no tensor and is never unpickled",
                "where it was made, save its state dict alone",
            ) from None  # fmt: skip
        raise InputError(path, "file", "is damaged, or no PyTorch checkpoint", mend) from None
