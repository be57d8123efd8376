"""The network: what a repository holds, and the bytes of one file, resumed where they were cut.

Requests go through huggingface_hub's session and `http_get`, which retries and resumes; its
`hf_hub_download` would begin a file again in the next process. The token of a logged-in user goes
to the hub only, or to the mirror that stands for it.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Self

from pydantic import BaseModel, ConfigDict, Field

from recast.core import files
from recast.core.errors import InputError
from recast.core.records import Record, validated
from recast.weights.fetched import FetchedFile, Sha256, file_record
from recast.weights.table import HUB, WeightsSource

MIRROR = "RECAST_WEIGHTS_MIRROR"
"""Environment variable that names a mirror: of the hub, and below HOST/PATH of other hosts."""
_HUB_MIRROR = "HF_ENDPOINT"

Step = Callable[[int], None]
Size = Annotated[int, Field(ge=0, le=1 << 50)]
"""Bytes of a file: more than a petabyte is a slip, and a sum of them must stay a float."""


class RemoteFile(Record):
    """A file at its publisher.

    Attributes:
        address: address at the publisher, not at a mirror.
        path: path below the weights' folder.
        size: number of bytes; None if the server does not say.
        sha256: SHA-256 of the bytes, by the table or the hub; None if neither says.
        blob: git's hash of a small file of a repository.
    """

    address: str
    path: str
    size: Size | None = None
    sha256: Sha256 | None = None
    blob: str | None = None


class _Lfs(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    sha256: Sha256
    size: Size


class _Sibling(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    rfilename: str = Field(max_length=1000)  # with a limit, half surrogate pairs are refused, too
    size: Size | None = None
    blob: str | None = Field(None, alias="blobId")
    lfs: _Lfs | None = None


class _Repository(BaseModel):
    """What api/models/NAME/revision/REVISION?blobs=true answers, as far as it is used."""

    model_config = ConfigDict(allow_inf_nan=False)

    sha: str = Field(pattern=r"^[0-9a-f]{40}$")
    siblings: list[_Sibling]


def actual(address: str) -> str:
    """The address that is asked instead of the publisher's."""
    mirror = (os.environ.get(MIRROR) or "").rstrip("/")
    if address.startswith(f"{HUB}/"):
        hub = mirror or (os.environ.get(_HUB_MIRROR) or HUB).rstrip("/")
        return hub + address.removeprefix(HUB)
    return f"{mirror}/{address.partition('://')[2]}" if mirror else address


def repository_files(source: WeightsSource) -> tuple[str, dict[str, RemoteFile]]:
    """The commit of a repository and all of its files by name.

    Raises:
        InputError: no answer, no such repository or commit, it asks for a login, or the answer is
            of another commit or none at all.
    """
    from huggingface_hub import get_session
    from huggingface_hub.utils import hf_raise_for_status

    page = f"{HUB}/{source.where}"
    address = f"{HUB}/api/models/{source.where}/revision/{source.revision or 'main'}"
    with _answers(page):
        answer = get_session().get(
            actual(address), params={"blobs": "true"}, headers=_headers(address), timeout=30.0
        )
        hf_raise_for_status(answer)
        listing = answer.content
    return listed_files(source, actual(address), listing)


_ELSEWHERE = "check the mirror if one is set, or try again later"


def listed_files(
    source: WeightsSource, where: str, listing: bytes
) -> tuple[str, dict[str, RemoteFile]]:
    """What a listing of a repository says, see `repository_files`.

    Args:
        where: address that answered, for messages.
        listing: JSON of the answer.

    Raises:
        InputError: the answer is of another commit, or not a listing.
    """
    value = files.parse_json(where, listing)
    found = validated(where, value, _Repository, _ELSEWHERE)
    if source.revision not in (None, found.sha):
        problem = f"answers with commit {found.sha}, not {source.revision}"
        raise InputError(where, "revision", problem, _ELSEWHERE)
    listed = {
        one.rfilename: RemoteFile(
            address=source.address(one.rfilename, found.sha),
            path=one.rfilename,
            size=one.lfs.size if one.lfs else one.size,
            sha256=one.lfs.sha256 if one.lfs else None,
            blob=None if one.lfs else one.blob,
        )
        for one in found.siblings
    }
    return found.sha, listed


def web_file(address: str) -> RemoteFile:
    """A file of a web server, with the size that it says.

    Raises:
        InputError: no answer, or no such file.
    """
    from huggingface_hub import get_session
    from huggingface_hub.utils import hf_raise_for_status

    with _answers(address):
        answer = get_session().head(
            actual(address), headers=_headers(address), timeout=30.0, follow_redirects=True
        )
        hf_raise_for_status(answer)
        length = answer.headers.get("Content-Length", "")
    known = length.isascii() and length.isdigit() and len(length) <= 15
    return RemoteFile(address=address, path="", size=int(length) if known else None)


def download(file: RemoteFile, target: Path, step: Step) -> FetchedFile:
    """Fetch a file, whole or not at all; what an earlier try left is continued, or found whole.

    Args:
        step: called with the number of bytes that are there by now.

    Returns:
        What was fetched.

    Raises:
        InputError: no answer, the transfer was cut again and again, the disk refuses, or the bytes
            are not those that the publisher or the table says; these are removed.
    """
    from huggingface_hub.file_download import http_get

    part = files.partial_name(target)
    with files.disk_errors(target):
        if target.is_file():
            found = file_record(target)
            if not _difference(file, found, target):
                return found
            target.unlink()
        target.parent.mkdir(parents=True, exist_ok=True)
        had = part.stat().st_size if part.exists() else 0
        if had and (file.size is None or had > file.size):
            part.unlink()
            had = 0
        with _answers(file.address), files.disk_errors(target), part.open("ab") as stream:
            http_get(
                actual(file.address),
                stream,
                resume_size=had,
                headers=_headers(file.address),
                expected_size=file.size,
                tqdm_class=_reporting(stream, step),
            )
        found = file_record(part)
        problem = _difference(file, found, part)
        if problem:
            part.unlink()
            mend = "try again; if it fails again, check the mirror if one is set"
            raise InputError(file.address, "bytes", problem, mend)
        part.replace(target)
    return found


def _difference(file: RemoteFile, found: FetchedFile, path: Path) -> str:
    """In what a file on disk is not what was asked for; empty if it is."""
    if file.size is not None and found.size != file.size:
        return f"are {found.size}, not {file.size}"
    if file.sha256 is not None and found.sha256 != file.sha256:
        return f"have SHA-256 {found.sha256}, not {file.sha256}"
    if file.blob is not None:
        digest = hashlib.sha1(b"blob %d\0" % found.size, usedforsecurity=False)
        with path.open("rb") as stream:
            blob = hashlib.file_digest(stream, lambda: digest).hexdigest()
        if blob != file.blob:
            return f"have git hash {blob}, not {file.blob}"
    return ""


def _headers(address: str) -> dict[str, str]:
    """Without compression, since bytes are counted; with the user's token for the hub."""
    from huggingface_hub import get_token

    token = get_token() if address.startswith(f"{HUB}/") else None
    login = {"authorization": f"Bearer {token}"} if token else {}
    return {"accept-encoding": "identity", "user-agent": "recast-sim"} | login


def _reporting(stream: BinaryIO, step: Step) -> Any:
    """A class that huggingface_hub takes for that of its progress bars."""

    class Reporting:
        def __init__(self, **options: object) -> None:
            """Title, unit and sizes are not used."""

        def __enter__(self) -> Self:
            return self

        def __exit__(self, *error: object) -> None:
            return

        def update(self, n: int) -> None:
            step(stream.tell() + n)  # before they are written

    return Reporting


@contextmanager
def _answers(address: str) -> Iterator[None]:
    """Whatever goes wrong on the way to a server is one line, and the library says nothing."""
    from huggingface_hub.errors import HfHubHTTPError, OfflineModeIsEnabled
    from huggingface_hub.utils import logging

    asked = actual(address)
    level = logging.get_verbosity()
    logging.set_verbosity_error()
    try:
        yield
    except InputError:
        raise
    except OfflineModeIsEnabled:
        raise InputError(
            asked,
            "network",
            "is switched off by HF_HUB_OFFLINE or TRANSFORMERS_OFFLINE",
            "unset it for `recast weights get`",
        ) from None
    except HfHubHTTPError as error:
        status = error.response.status_code
        if status in (401, 403):
            problem = "asks for a login: it is gated, private or missing"
            mend = f"accept its terms at {address}, then `hf auth login` or set HF_TOKEN"
        else:
            problem = "does not exist" if status == 404 else f"answers with HTTP status {status}"
            mend = "check the mirror" if asked != address else "try again later"
        raise InputError(asked, "server", problem, mend) from error
    except Exception as error:  # of the HTTP library, of TLS, of the system
        reason = str(error).strip().splitlines()
        problem = f"does not answer ({type(error).__name__}: {reason[0] if reason else ''})"
        mend = "check the connection; the same command resumes"
        raise InputError(asked, "network", problem, mend) from error
    finally:
        logging.set_verbosity(level)
