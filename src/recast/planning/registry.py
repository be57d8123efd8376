"""Planners by name: shipped, installed, code, folders, and programs of others."""

from __future__ import annotations

import re
from pathlib import Path

from recast import weights
from recast.core.arguments import checked
from recast.core.artefact import folder_hash
from recast.core.errors import InputError
from recast.core.foreign import whole
from recast.core.plugins import PLANNERS
from recast.planning.types import BasePlanner, Planner

DEVICE_PATTERN = r"auto|cpu|cuda(:\d{1,3})?"
"""What users may say, as a regular expression."""
GTRS_MINI = "gtrs-mini"
SHIPPED = (GTRS_MINI, "gtrs-mini-oracle", "gtrs-mini-replaced")
"""Planners that come with the package, each in a folder of its name. The second one never saw a
reconstructed image; what the third saw of vehicles that do what no log has were replaced ones."""


@checked()
def make_planner(planner: str | Path | Planner, device: str = "auto") -> BasePlanner:
    """Create a planner, or return the one given, with all members that it lacks.

    Args:
        planner: one of `PLANNERS.names()`; or "package.module:attribute" of a class or function
            that returns a `Planner` when called without arguments; or a folder that `save_gtrs`
            wrote; or a `Planner`; or, with recast-bridges, "navsim:package.module:attribute" of a
            class or function that returns a NAVSIM agent, "alpasim:HOST:PORT" of a driver of
            AlpaSim, or "neuroncap:HOST:PORT" of a program that plans. See
            `recast.core.plugins.Registry.resolve`.
        device: device on which it computes, see `planner_device`. A class or function of the user's
            is given it if it has a parameter `device`; what has none decides itself.

    Raises:
        InputError: there is no such device; the name is unknown, the module does not import, what
            it names raises when it is called (its exception is the error's `__cause__`) or makes no
            planner; or a file of the folder is missing or wrong.
    """
    options = {}
    if PLANNERS.takes(planner, "device"):
        options["device"] = planner_device(device)
    return whole(PLANNERS.resolve(planner, **options), BasePlanner)


def planner_folder(name: str) -> Path | None:
    """The folder that holds all of a planner, or None where code makes it.

    It need not be there.
    """
    if name in SHIPPED:
        return shipped_folder(name)
    return PLANNERS.place(name)


def planner_source(name: str) -> str:
    """What stands for a planner in keys of artefacts; see `recast.core.plugins.Registry.source`.

    Raises:
        InputError: the name is unknown, or a program that it names does not answer.
    """
    folder = planner_folder(name)
    return PLANNERS.source(name) if folder is None else folder_hash(folder)


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
        raise InputError("planner device", name, f"does not exist: torch finds {count} GPUs", mend)
    return name


def shipped_folder(name: str = GTRS_MINI) -> Path:
    """The folder of a planner that comes with the package, as `recast.planning.gtrs.save_gtrs`
    writes it."""
    return weights.shipped_folder(name)


def gtrs_mini_planner(device: str = "cpu") -> Planner:
    """The planner `gtrs-mini`.

    Args:
        device: device on which it computes, as torch calls it.

    Raises:
        InputError: this installation lacks the folder, or it is damaged.
    """
    return _shipped(GTRS_MINI, device)


def gtrs_mini_oracle_planner(device: str = "cpu") -> Planner:
    """The planner `gtrs-mini-oracle`; see `gtrs_mini_planner`."""
    return _shipped("gtrs-mini-oracle", device)


def gtrs_mini_replaced_planner(device: str = "cpu") -> Planner:
    """The planner `gtrs-mini-replaced`; see `gtrs_mini_planner`."""
    return _shipped("gtrs-mini-replaced", device)


def _shipped(name: str, device: str) -> Planner:
    folder = shipped_folder(name)
    if not folder.is_dir():
        raise InputError(
            "planner",
            name,
            f"its weights are missing from this installation ({folder})",
            "install a release with its weights, or name the folder of another GTRS planner",
        )
    from recast.planning.gtrs import load_gtrs  # here, as it needs torch and others do not

    return load_gtrs(folder, device)
