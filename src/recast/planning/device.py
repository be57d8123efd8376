"""Where a planner computes."""

from __future__ import annotations

import re

from recast.errors import InputError

DEVICE_PATTERN = r"auto|cpu|cuda(:\d{1,3})?"
"""What users may say, as a regular expression."""


def planner_device(name: str = "auto") -> str:
    """A device in torch's words: "cpu", "cuda" or "cuda:1".

    Args:
        name: one of these; or "auto", which is CUDA where there is a GPU, otherwise the CPU.

    Raises:
        InputError: another name, or no such GPU here.
    """
    mend = "choose auto, cpu, cuda, or cuda:1 for the second GPU"
    if not re.fullmatch(DEVICE_PATTERN, name):
        raise InputError("planner device", name, "is unknown", mend)
    if name == "cpu":
        return name
    import torch  # here, as planners that read states need none of it

    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if int(name.partition(":")[2] or 0) >= count:
        raise InputError("planner device", name, f"is not there: torch sees {count} GPUs", mend)
    return name
