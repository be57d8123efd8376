"""Any driving log by one call: a log folder, here or in object storage, or a dataset's drive."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from recast.errors import InputError
from recast.logs.checks import refused
from recast.logs.remote import CopyProgress, local_folder
from recast.logs.store import read_log
from recast.logs.types import DrivingLog
from recast.parts import IMPORTERS

if TYPE_CHECKING:
    from upath import UPath


def load_log(
    source: str | Path | UPath | DrivingLog,
    *,
    importer: str | Callable[..., DrivingLog] | None = None,
    drive: str | None = None,
    labels: str | Path | None = None,
    cameras: Sequence[str] = (),
    progress: CopyProgress | None = None,
    **options: Any,
) -> DrivingLog:
    """Load a driving log; its images and sweeps are decoded when asked for.

    Args:
        source: a log folder; or its address in object storage, such as "s3://bucket/folder" or a
            `UPath`, from where it is copied once (see `recast.logs.remote.local_folder`); or the
            dataset's folder, with `importer`; or a log, which is returned as it is.
        importer: name of the dataset's importer, such as "kitti", "package.module:attribute", or a
            `LogImporter`. Nothing is written; see `write_log`.
        drive: the drive's name in the dataset; needed with `importer`.
        labels: box labels that lie apart from the drive; only with `importer`.
        cameras: names of the cameras to import; the importer's default if empty; only with
            `importer`.
        progress: called with the bytes copied so far and with all there are.
        options: further ones of the importer, such as `refine` of "kitti".

    Returns:
        a valid log in recast's frames and units, see `DrivingLog`. Its `origin` is the folder it
        was read from, or None if it was imported.

    Raises:
        InputError: no such folder, address, importer, drive or option; the remote does not answer;
            or files are missing or broken. The line names the file and the field.

    >>> sorted(load_log(folder / "log").tracks)
    ['0', '1']
    """
    if importer is not None:
        given = {
            **({} if labels is None else {"labels": Path(labels)}),
            **({"cameras": tuple(cameras)} if cameras else {}),
            **options,
        }
        return _imported(importer, source, drive, given)
    if drive is not None or labels is not None or cameras or options:
        problem = "is missing, but a drive or options of an importer are given"
        raise InputError("load_log", "importer", problem, 'name one, such as importer="kitti"')
    if isinstance(source, DrivingLog):
        return source
    return read_log(local_folder(source, progress))


def _imported(
    importer: str | Callable[..., DrivingLog], root: Any, drive: str | None, given: dict[str, Any]
) -> DrivingLog:
    load: Callable[..., DrivingLog] = IMPORTERS.resolve(importer)
    name = importer if isinstance(importer, str) else getattr(importer, "__name__", "object")
    if not isinstance(root, str | os.PathLike) or "://" in os.fspath(root):
        shown = root if isinstance(root, str) else type(root).__name__
        raise InputError("importer", name, f"cannot read {shown}", "name a local folder")
    if drive is None:
        raise InputError("importer", name, "needs the name of a drive", "give the drive")
    _check_options(name, load, given)
    log = load(Path(root), drive, **given)
    if not isinstance(log, DrivingLog):
        problem = f"returned {type(log).__name__} in place of a DrivingLog"
        raise InputError("importer", name, problem, "return the log; write_log writes it")
    with refused(f"{root}: log {log.name}", "use the dataset's files as published"):
        log.validate()
    return log


def _check_options(name: str, load: Callable[..., DrivingLog], given: Mapping[str, Any]) -> None:
    """Refuse an importer of an older release, and options that an importer does not have."""
    try:
        known = inspect.signature(load).parameters
    except (TypeError, ValueError):  # made in C
        return
    if "out" in known:
        raise InputError(
            "importer", name, "takes `out` and writes the log itself, as importers once did",
            "change it to (root, drive, labels=None, cameras=()) and return the DrivingLog",
        )  # fmt: skip
    if any(one.kind is inspect.Parameter.VAR_KEYWORD for one in known.values()):
        return
    for option in given:
        if option not in known:
            raise InputError("importer", name, f"has no option {option}", "leave it out")
