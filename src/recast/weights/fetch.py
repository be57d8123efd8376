"""Fetches published weights once: plan, download, convert, record; each step survives a kill."""

from __future__ import annotations

import fnmatch
import importlib
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from recast.core import files
from recast.core.artefact import value_hash
from recast.core.errors import InputError
from recast.core.files import atomic_file
from recast.core.names import member
from recast.core.records import Record, read_record
from recast.weights import transfer
from recast.weights.fetched import (
    RECORD_FILE,
    FetchedFile,
    WeightsRecord,
    opened,
    read_weights_record,
    remember,
    weights_folder,
    written_files,
)
from recast.weights.table import Weights, WeightsSource

_PICKLE, _SAFETENSORS = "pytorch_model.bin", "model.safetensors"
PLAN_FILE = ".plan.json"

Progress = Callable[[str, int, int | None], None]
"""Called with a file's name, the bytes of it that came by now, and all of them if known."""


class FetchPlan(Record):
    """What is to be fetched; kept until it is done, so that a branch that moves changes nothing.

    Attributes:
        entry: hash of the table's entry.
        revisions: commits of the repositories.
    """

    version: Literal[1] = 1
    entry: str
    revisions: dict[str, str]
    files: tuple[transfer.RemoteFile, ...]


def fetch(
    weights: Weights, *, accepted: bool = False, progress: Progress = lambda name, done, of: None
) -> Path:
    """Fetch weights, or find them: nothing is asked of the network then.

    What was cut is continued where it stopped. The folder comes into being when all files are
    there, checked and converted.

    Args:
        accepted: whether the user accepted the licences, see `Weights.restricted`.

    Returns:
        What stands for the name, see `Weights.opens`.

    Raises:
        InputError: a licence is not accepted; the network or the disk refuses; bytes are not those
            that are pinned; the repository lacks a file; another process is fetching them; or
            files that are here changed.
    """
    folder = weights_folder(weights.name)
    if is_whole(weights, folder):
        return opened(weights)
    if weights.restricted and not accepted:
        terms = next(one for one in weights.licences if one.restricted)
        raise InputError(
            "weights",
            weights.name,
            f"have licence terms that you must accept ({terms.name}, {terms.link})",
            "read them, then add `accept_licence`",
        )
    partial = files.partial_name(folder)
    with files.disk_errors(partial):
        partial.mkdir(parents=True, exist_ok=True)
    with files.alone_in(partial), files.disk_errors(partial):
        if not is_whole(weights, partial):
            _fill(weights, partial, progress)
        _finish(partial, folder)
    return opened(weights)


def is_whole(weights: Weights, folder: Path) -> bool:
    """Whether a folder holds the record of all files that an entry asks for.

    Raises:
        InputError: the record is damaged.
    """
    return (folder / RECORD_FILE).is_file() and read_weights_record(folder).is_of(weights)


def _fill(weights: Weights, partial: Path, progress: Progress) -> None:
    """Download and convert all files into a folder, then write the record."""
    plan = _plan(weights, partial)
    targets = {file.path: member(partial, file.path, file.address, "name") for file in plan.files}
    _require_space(weights, plan, partial)
    fetched: dict[str, FetchedFile] = {}
    for file in plan.files:

        def step(came: int, file: transfer.RemoteFile = file) -> None:
            progress(file.path, came, file.size)

        fetched[file.path] = transfer.download(file, targets[file.path], step)
    if weights.converter:
        module, _, function = weights.converter.partition(":")
        getattr(importlib.import_module(module), function)(partial)
    record = WeightsRecord(
        name=weights.name,
        revisions=plan.revisions,
        fetched={file.address: fetched[file.path] for file in plan.files},
        converter=weights.converter,
        files=written_files(partial, weights.converted, fetched),
    )
    files.write_json(partial / RECORD_FILE, record.model_dump(mode="json"))


def _finish(partial: Path, folder: Path) -> None:
    """Remove what the record does not name, and give the folder its name; an older one goes."""
    record = read_weights_record(partial)
    for path in sorted(partial.rglob("*")):
        name = path.relative_to(partial).as_posix()
        if path.is_file() and name not in record.files and name != RECORD_FILE:
            path.unlink()
    older = folder.with_name(f".{folder.name}.older")
    shutil.rmtree(older, ignore_errors=True)
    if folder.exists():
        folder.rename(older)
    partial.rename(folder)
    remember(folder, record)
    shutil.rmtree(older, ignore_errors=True)


def _plan(weights: Weights, partial: Path) -> FetchPlan:
    """The plan of an earlier try if it is for the same entry; else a new one in an empty folder."""
    entry = value_hash(
        [
            [one.where, one.files, one.revision, dict(one.sha256), one.into]
            for one in weights.sources
        ]
    )
    path = partial / PLAN_FILE
    if path.is_file():
        plan = read_record(path, FetchPlan, 1, f"remove {partial}")
        if plan.entry == entry:
            return plan
    for old in partial.iterdir():
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    revisions: dict[str, str] = {}
    planned: list[transfer.RemoteFile] = []
    for source in weights.sources:
        if source.repository:
            revisions[source.where], found = transfer.repository_files(source)
            names = [name for wanted in source.files for name in _matching(source, wanted, found)]
        else:
            found = {name: transfer.web_file(source.address(name)) for name in source.files}
            names = list(source.files)
        planned += [_planned(source, name, found[name]) for name in dict.fromkeys(names)]
    plan = FetchPlan(entry=entry, revisions=revisions, files=tuple(planned))
    files.write_json(path, plan.model_dump(mode="json"))
    return plan


def _matching(
    source: WeightsSource, wanted: str, found: dict[str, transfer.RemoteFile]
) -> list[str]:
    names = fnmatch.filter(found, wanted) if "*" in wanted else [wanted] * (wanted in found)
    if not names:
        raise InputError(
            source.where,
            wanted,
            f"is not in the repository at {source.revision or 'main'}",
            "tell the maintainers of recast: the publisher changed the layout",
        )
    return names


def _planned(source: WeightsSource, name: str, file: transfer.RemoteFile) -> transfer.RemoteFile:
    pinned = source.sha256.get(name, file.sha256)
    if file.sha256 not in (None, pinned):
        problem = f"have SHA-256 {file.sha256} on the server, recast pins {pinned}"
        raise InputError(
            file.address, "bytes", problem, "check the mirror if one is set; nothing was downloaded"
        )
    path = f"{source.into}/{name}" if source.into else name
    return file.model_copy(update={"path": path, "sha256": pinned})


def _require_space(weights: Weights, plan: FetchPlan, partial: Path) -> None:
    """Refuse a disk that cannot take what is still to come, before anything comes."""
    needed = 0
    for file in plan.files:
        target = partial / file.path
        part = files.partial_name(target)
        there = [one.stat().st_size for one in (target, part) if one.is_file()]
        needed += max(0, (file.size or 0) - sum(there))
        if file.path in weights.converted:
            needed += file.size or 0
    free = shutil.disk_usage(partial).free
    if needed > free:
        problem = f"has {free / 1e9:.1f} GB free, {weights.name} needs {needed / 1e9:.1f} GB"
        raise InputError(partial.parent, "disk", problem, "free some space, or set RECAST_WEIGHTS")


def safetensors_of_pickle(folder: Path) -> None:
    """Write model.safetensors from pytorch_model.bin, of which nothing but tensors is unpickled.

    Names, types and values stay; tensors that share memory are stored apart.

    Raises:
        InputError: the file holds other objects than tensors, or the disk refuses.
    """
    import torch  # only a few of the published weights are converted
    from safetensors import SafetensorError
    from safetensors.torch import save_file

    from recast.core.torch_file import read_tensors

    found = read_tensors(folder / _PICKLE, "weights", "remove the folder and download it again")
    apart: dict[str, torch.Tensor] = {}
    memory: set[int] = set()
    for name, tensor in found.items():
        dense = tensor.contiguous()
        at = dense.untyped_storage().data_ptr()
        apart[name] = dense.clone() if at in memory else dense
        memory.add(at)
    with atomic_file(folder / _SAFETENSORS) as partial:
        try:
            save_file(apart, partial, {"format": "pt"})
        except SafetensorError as error:  # a full disk is said in a way of its own
            problem = f"cannot be written ({error})"
            raise InputError(
                folder / _SAFETENSORS, "file", problem, "free some space and run again"
            ) from error
