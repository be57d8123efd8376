"""What every importer promises of the log that it returns."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Concatenate, ParamSpec

from recast.logs.checks import refused
from recast.logs.types import DrivingLog
from recast.storage import disk_errors

Rest = ParamSpec("Rest")


def returns_valid(
    load: Callable[Concatenate[Path, Rest], DrivingLog],
) -> Callable[Concatenate[Path, Rest], DrivingLog]:
    """A decorator: the log is valid, and what the disk refuses below the first argument, the
    dataset's folder, is one line."""

    @wraps(load)
    def loaded(root: Path, /, *args: Rest.args, **options: Rest.kwargs) -> DrivingLog:
        with disk_errors(root):
            log = load(root, *args, **options)
        with refused(f"{root}: log {log.name}", "use the dataset's files as published"):
            log.validate()
        return log

    return loaded
