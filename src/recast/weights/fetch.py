"""Downloads published weights once: list, download, check, convert, record; each survives a kill.

`huggingface_hub.snapshot_download` transfers the files of repositories, its `http_get` those of
other hosts. Every file is then compared with the size and the hash that the table or the hub says.
The token of a logged-in user goes to the hub only, or to the mirror that stands for it.
"""

from __future__ import annotations

import fnmatch
import hashlib
import importlib
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from recast.core import files
from recast.core.errors import InputError
from recast.core.files import member
from recast.core.records import Record, validated
from recast.weights.table import (
    HUB,
    RECORD_FILE,
    FetchedFile,
    Sha256,
    Weights,
    WeightsRecord,
    WeightsSource,
    file_record,
    opened,
    read_weights_record,
    remember,
    weights_folder,
    written_files,
)

MIRROR = "RECAST_WEIGHTS_MIRROR"
"""Environment variable that names a mirror: of the hub, and below HOST/PATH of other hosts."""
_HUB_MIRROR = "HF_ENDPOINT"
_PICKLE, _SAFETENSORS = "pytorch_model.bin", "model.safetensors"
_ELSEWHERE = "check the mirror if one is set, or try again later"

Progress = Callable[[str, int, int | None], None]
"""Called with the name of a source, its bytes that came by now, and all of them if known."""


class _File(Record):
    """A file at its publisher.

    Attributes:
        name: name below its source.
        size: number of bytes; None if the server does not say. More than a petabyte is a slip.
        sha256: SHA-256 of the bytes, by the table or the hub; None if neither says.
        blob: git's hash of a small file of a repository.
    """

    name: str = Field(max_length=1000)  # with a limit, half surrogate pairs are refused, too
    size: Annotated[int, Field(ge=0, le=1 << 50)] | None = None
    sha256: Sha256 | None = None
    blob: str | None = None


class SourceListing(Record):
    """What a source has of the files that the table asks for.

    Attributes:
        commit: commit of the repository; empty for a web folder.
    """

    commit: str = Field(default="", pattern=r"^([0-9a-f]{40})?$")
    files: tuple[_File, ...]


def fetch(
    weights: Weights, *, accepted: bool = False, progress: Progress = lambda name, done, of: None
) -> Path:
    """Download weights, or find them without asking the network for anything.

    Files that an interrupted download finished are kept. The folder gets its name when all files
    are there, checked and converted.

    Args:
        accepted: whether the user accepted the licences, see `Weights.restricted`.

    Returns:
        What stands for the name, see `Weights.opens`.

    Raises:
        InputError: a licence is not accepted; the network or the disk refuses; bytes are not those
            that are pinned; the repository lacks a file; another process is downloading them; or
            files that are here changed.
    """
    folder = weights_folder(weights.name)
    if is_whole(weights, folder):
        return opened(weights)
    if weights.restricted and not accepted:
        terms = next(one for one in weights.licences if one.restricted)
        problem = f"have licence terms that you must accept ({terms.name}, {terms.link})"
        raise InputError("weights", weights.name, problem, "read them, then add `accept_licence`")
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
    """Download, check and convert all files into a folder, then write the record."""
    listings = [(source, list_source(source)) for source in weights.sources]
    targets = {
        member(partial / source.into, file.name, source.address(file.name), "name"): file
        for source, listing in listings
        for file in listing.files
    }
    kept = {*targets, *map(files.partial_name, targets)}
    for path in partial.rglob("*"):  # what an earlier commit or a converter left goes
        if path.is_file() and path not in kept and ".cache" not in path.parts:
            path.unlink()
    _require_space(weights, targets, partial)
    fetched: dict[str, FetchedFile] = {}
    known: dict[str, FetchedFile] = {}
    for source, listing in listings:
        _download(source, listing, partial / source.into, progress)
        for file in listing.files:
            path = partial / source.into / file.name
            address = source.address(file.name, listing.commit)
            found = _checked(file, path, address)
            fetched[address] = known[path.relative_to(partial).as_posix()] = found
    if weights.converter:
        module, _, function = weights.converter.partition(":")
        getattr(importlib.import_module(module), function)(partial)
    record = WeightsRecord(
        name=weights.name,
        revisions={source.where: listing.commit for source, listing in listings if listing.commit},
        fetched=fetched,
        converter=weights.converter,
        files=written_files(partial, weights.converted, known),
    )
    files.write_json(partial / RECORD_FILE, record.model_dump(mode="json"))


def _finish(partial: Path, folder: Path) -> None:
    """Remove what the record does not name, and give the folder its name; an older one goes."""
    record = read_weights_record(partial)
    for path in sorted(partial.rglob("*"), reverse=True):
        name = path.relative_to(partial).as_posix()
        if path.is_file() and name not in record.files and name != RECORD_FILE:
            path.unlink()
        elif path.is_dir() and not any(path.iterdir()):
            path.rmdir()
    older = folder.with_name(f".{folder.name}.older")
    shutil.rmtree(older, ignore_errors=True)
    if folder.exists():
        folder.rename(older)
    partial.rename(folder)
    remember(folder, record)
    shutil.rmtree(older, ignore_errors=True)


def _require_space(weights: Weights, targets: dict[Path, _File], partial: Path) -> None:
    """Refuse a disk that cannot take what is still to come, before anything comes."""
    needed = 0
    for path, file in targets.items():
        size = file.size or 0
        there = (one for one in (path, files.partial_name(path)) if one.is_file())
        needed += max(0, size - sum(one.stat().st_size for one in there))
        if path.relative_to(partial).as_posix() in weights.converted:
            needed += size
    free = shutil.disk_usage(partial).free
    if needed > free:
        problem = f"has {free / 1e9:.1f} GB free, {weights.name} needs {needed / 1e9:.1f} GB"
        raise InputError(partial.parent, "disk", problem, "free some space, or set RECAST_WEIGHTS")


def _actual(address: str) -> str:
    """The address that is asked instead of the publisher's."""
    mirror = (os.environ.get(MIRROR) or "").rstrip("/")
    if address.startswith(HUB):
        hub = mirror or (os.environ.get(_HUB_MIRROR) or HUB).rstrip("/")
        return hub + address.removeprefix(HUB)
    return f"{mirror}/{address.partition('://')[2]}" if mirror else address


def list_source(source: WeightsSource) -> SourceListing:
    """Ask a source for the files of the table, and compare the answer with the pins.

    Raises:
        InputError: no answer, no such repository, commit or file, it asks for a login, or the
            answer is of another commit, of other hashes, or unusable.
    """
    from huggingface_hub import HfApi, get_session
    from huggingface_hub.utils import hf_raise_for_status

    if not source.repository:
        found = []
        for name in source.files:
            address = source.address(name)
            with _answers(address):
                asked = {"accept-encoding": "identity"}
                answer = get_session().head(
                    _actual(address), headers=asked, timeout=30.0, follow_redirects=True
                )
                hf_raise_for_status(answer)
            length = answer.headers.get("Content-Length", "")
            size = (
                int(length) if length.isascii() and length.isdigit() and len(length) < 16 else None
            )
            found.append(_File(name=name, size=size, sha256=source.sha256.get(name)))
        return SourceListing(files=tuple(found))
    page, wanted = f"{HUB}/{source.where}", source.revision or "main"
    with _answers(page):
        api = HfApi(endpoint=_actual(HUB), library_name="recast")
        info = api.model_info(source.where, revision=wanted, files_metadata=True, timeout=30.0)
        listed = [
            {
                "name": one.rfilename,
                "size": one.lfs.size if one.lfs else one.size,
                "sha256": one.lfs.sha256 if one.lfs else None,
                "blob": None if one.lfs else one.blob_id,
            }
            for one in info.siblings or []
        ]
    answer = {"commit": info.sha, "files": listed}
    listing = validated(_actual(page), answer, SourceListing, _ELSEWHERE)
    if source.revision not in (None, listing.commit):
        problem = f"answers with commit {listing.commit}, not {source.revision}"
        raise InputError(_actual(page), "revision", problem, _ELSEWHERE)
    for pattern in source.files:
        if not fnmatch.filter([file.name for file in listing.files], pattern):
            problem = f"is not in the repository at {wanted}"
            mend = "tell the maintainers of recast: the publisher changed the layout"
            raise InputError(source.where, pattern, problem, mend)
    asked_for = (
        file
        for file in listing.files
        if any(fnmatch.fnmatch(file.name, pattern) for pattern in source.files)
    )
    return SourceListing(
        commit=listing.commit, files=tuple(_pinned(source, file) for file in asked_for)
    )


def _pinned(source: WeightsSource, file: _File) -> _File:
    pinned = source.sha256.get(file.name, file.sha256)
    if file.sha256 not in (None, pinned):
        problem = f"have SHA-256 {file.sha256} on the server, recast pins {pinned}"
        mend = "check the mirror if one is set; nothing was downloaded"
        raise InputError(source.address(file.name), "bytes", problem, mend)
    return file.model_copy(update={"sha256": pinned})


def _download(
    source: WeightsSource, listing: SourceListing, folder: Path, progress: Progress
) -> None:
    """Download the files of a source that are not there yet.

    Raises:
        InputError: no answer, the transfer was cut again and again, or the disk refuses.
    """
    from huggingface_hub import snapshot_download
    from huggingface_hub.file_download import http_get

    total = sum(file.size or 0 for file in listing.files) or None
    bars = _reporting(lambda came: progress(source.where, came, total))
    if source.repository:
        with _answers(f"{HUB}/{source.where}"), files.disk_errors(folder):
            snapshot_download(
                source.where,
                revision=listing.commit,
                local_dir=folder,
                allow_patterns=[*source.files],
                endpoint=_actual(HUB),
                library_name="recast",
                tqdm_class=bars,
            )
        return
    for file in listing.files:
        target, address = folder / file.name, source.address(file.name)
        if target.is_file():
            continue
        part = files.partial_name(target)
        with _answers(address), files.disk_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            had = part.stat().st_size if part.exists() and file.size is not None else 0
            with part.open("ab" if 0 < had <= (file.size or 0) else "wb") as stream:
                asked = {"accept-encoding": "identity"}
                http_get(
                    _actual(address),
                    stream,
                    resume_size=stream.tell(),
                    headers=asked,
                    expected_size=file.size,
                    tqdm_class=bars,
                )
            part.replace(target)


def _checked(file: _File, path: Path, address: str) -> FetchedFile:
    """What was downloaded; bytes that are not those that were asked for are removed.

    Raises:
        InputError: the file is missing, or has another size or hash.
    """
    mend = "try again; if it fails again, check the mirror if one is set"
    if not path.is_file():
        raise InputError(address, "file", "was not downloaded", mend)
    found, problem = file_record(path), ""
    if file.size not in (None, found.size):
        problem = f"are {found.size}, not {file.size}"
    elif file.sha256 not in (None, found.sha256):
        problem = f"have SHA-256 {found.sha256}, not {file.sha256}"
    elif file.blob is not None:
        digest = hashlib.sha1(b"blob %d\0" % found.size, usedforsecurity=False)
        with path.open("rb") as stream:
            blob = hashlib.file_digest(stream, lambda: digest).hexdigest()
        problem = "" if blob == file.blob else f"have git hash {blob}, not {file.blob}"
    if problem:
        path.unlink()
        raise InputError(address, "bytes", problem, mend)
    return found


def _reporting(step: Callable[[int], None]) -> Any:
    """A class for progress bars of huggingface_hub that draws nothing and counts bytes."""
    from huggingface_hub.utils import tqdm

    class Reporting(tqdm):
        def __init__(self, *values: Any, **options: Any) -> None:
            name, begun = options.get("name", ""), options.get("initial", 0)
            self._bytes = begun if name in _BYTES else None
            super().__init__(*values, **options | {"disable": True})

        def update(self, n: float | None = 1) -> bool | None:
            if self._bytes is not None:
                self._bytes += int(n or 0)
                step(self._bytes)
            return None

    return Reporting


_BYTES = ("huggingface_hub.snapshot_download", "huggingface_hub.http_get")
"""Names of the library's bars that count bytes on disk."""


@contextmanager
def _answers(address: str) -> Iterator[None]:
    """Whatever goes wrong on the way to a server is one line, and the library says nothing."""
    from huggingface_hub.errors import HfHubHTTPError, OfflineModeIsEnabled
    from huggingface_hub.utils import logging

    asked = _actual(address)
    level = logging.get_verbosity()
    logging.set_verbosity_error()
    try:
        yield
    except InputError:
        raise
    except OfflineModeIsEnabled:
        problem = "is switched off by HF_HUB_OFFLINE or TRANSFORMERS_OFFLINE"
        raise InputError(asked, "network", problem, "unset it for `recast weights get`") from None
    except HfHubHTTPError as error:
        status = error.response.status_code
        if status in (401, 403):
            problem = "asks for a login: it is gated, private or missing"
            mend = f"accept its terms at {address}, then `hf auth login` or set HF_TOKEN"
        else:
            problem = "does not exist" if status == 404 else f"answers with HTTP status {status}"
            mend = "check the mirror" if asked != address else "try again later"
        raise InputError(asked, "server", problem, mend) from error
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
        problem = f"gives an answer that cannot be used ({_first_line(error)})"
        raise InputError(asked, "server", problem, _ELSEWHERE) from error
    except Exception as error:  # of the HTTP library, of TLS, of the system
        problem = f"does not answer ({_first_line(error)})"
        mend = "check the connection; the same command resumes"
        raise InputError(asked, "network", problem, mend) from error
    finally:
        logging.set_verbosity(level)


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0] if lines else ''}"


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
    with files.atomic_file(folder / _SAFETENSORS) as partial:
        try:
            save_file(apart, partial, {"format": "pt"})
        except SafetensorError as error:  # a full disk is said in a way of its own
            problem = f"cannot be written ({error})"
            where = folder / _SAFETENSORS
            raise InputError(where, "file", problem, "free some space and run again") from error
