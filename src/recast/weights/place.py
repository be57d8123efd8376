"""Where fetched weights lie, and what a name stands for."""

from __future__ import annotations

import os
from pathlib import Path
from typing import overload

from recast.errors import InputError
from recast.weights.table import PUBLISHED, Weights

RECAST_WEIGHTS = "RECAST_WEIGHTS"
"""Environment variable that names another folder than weights/ in the cache of recast."""


def weights_folder(*parts: str) -> Path:
    """The folder that holds fetched weights, each below its name."""
    named_folder = os.environ.get(RECAST_WEIGHTS)
    if named_folder:
        return Path(named_folder).expanduser().joinpath(*parts)
    from recast.core.remote import cache_folder  # imports upath, in tens of milliseconds

    return cache_folder("weights", *parts)


def place(part: str, name: str) -> Path | None:
    """The folder or file that a name of published weights stands for, checked before it is used.

    Args:
        part: kind of exchangeable part, such as "generator", see `Weights.part`.

    Returns:
        None if it is no name of weights for that part.

    Raises:
        InputError: they were not fetched, changed on disk, or are not those that the table pins.
    """
    weights = PUBLISHED.get(name)
    return opened(weights) if weights is not None and part == weights.part else None


@overload
def located(option: str, value: Path) -> Path: ...


@overload
def located(option: str, value: Path | None) -> Path | None: ...


def located(option: str, value: Path | None) -> Path | None:
    """What the value of an option that takes a path stands for.

    Args:
        value: a path, which is given back if it exists; or a name of published weights.

    Raises:
        InputError: see `place`.
    """
    if value is None or value.exists():
        return value
    weights = PUBLISHED.get(str(value))
    return opened(weights) if weights is not None and option in weights.options else value


def opened(weights: Weights) -> Path:
    """The folder or file of fetched weights.

    Raises:
        InputError: see `place`.
    """
    from recast.weights.record import RECORD_FILE, read_weights_record, verify

    folder = weights_folder(weights.name)
    get = f"run `recast weights get {weights.name}`"
    if not (folder / RECORD_FILE).is_file():
        raise InputError("weights", weights.name, "are not here", get)
    record = read_weights_record(folder)
    if not record.is_of(weights):
        problem = "are of another version than this recast pins"
        raise InputError("weights", weights.name, problem, get)
    verify(folder, record, every_byte=False)
    return folder / weights.opens if weights.opens else folder


def is_fetched(name: str) -> bool:
    """Whether weights are here; their bytes are not looked at."""
    from recast.weights.record import RECORD_FILE

    return (weights_folder(name) / RECORD_FILE).is_file()
