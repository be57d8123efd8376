"""A hub on loopback: listings, `resolve` with redirects and ranges, and what can go wrong."""

from __future__ import annotations

import hashlib
import json
import mmap
import random
import re
from dataclasses import dataclass, field
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.parse import parse_qs, unquote, urlsplit

from recast.weights import Licence, Weights, WeightsSource

LARGE = 1000
"""Bytes from which a file is stored as Git LFS does: hashed by SHA-256, and served elsewhere."""

Content = bytes | Path


Data = bytes | memoryview


def data_of(content: Content) -> Data:
    """The bytes; of files without reading them into memory."""
    if not isinstance(content, Path):
        return content
    with content.open("rb") as file:
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def sha256(data: Data) -> str:
    return hashlib.sha256(data).hexdigest()


@cache
def hashes(content: Content) -> tuple[str, str]:
    """SHA-256, and git's hash."""
    data = data_of(content)
    blob = hashlib.sha1(b"blob %d\0" % len(data))
    blob.update(data)
    return sha256(data), blob.hexdigest()


@dataclass
class Hub:
    """Repositories by name: commits in order, the last is the main branch; each is files by name.

    Attributes:
        web: files of other hosts, by "host/path".
        asked: method, path and range of every request.
        sent: bytes of files that were sent.
        cuts: bytes after which the connection breaks, of the next transfers that have as many.
        ranges: whether a part of a file can be asked for.
        token: a login that repositories ask for.
        wrong_commit: what listings say instead of the commit.
        listing: bytes of every listing, instead of its own.
        served_instead: bytes of files, by the last part of their name.
    """

    repositories: dict[str, dict[str, dict[str, Content]]] = field(default_factory=dict)
    web: dict[str, Content] = field(default_factory=dict)
    asked: list[tuple[str, str, str]] = field(default_factory=list)
    sent: int = 0
    cuts: list[int] = field(default_factory=list)
    ranges: bool = True
    token: str = ""
    wrong_commit: str = ""
    listing: bytes = b""
    served_instead: dict[str, bytes] = field(default_factory=dict)
    server: ThreadingHTTPServer | None = None

    @property
    def address(self) -> str:
        assert self.server is not None
        return f"http://127.0.0.1:{self.server.server_address[1]}"

    def commit(self, repository: str, files: dict[str, Content]) -> str:
        """Publish files; the commit is 40 digits that depend on their order only."""
        for content in files.values():
            hashes(content)  # now, not while a client waits
        commits = self.repositories.setdefault(repository, {})
        name = hashlib.sha1(f"{repository} {len(commits)}".encode()).hexdigest()
        commits[name] = files
        return name

    def start(self) -> None:
        hub = self

        class Answer(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                hub.answer(self)

            do_HEAD = do_GET  # noqa: N815

            def log_message(self, *args: object) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Answer)
        self.server.daemon_threads = True
        Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()

    def stop(self) -> None:
        if self.server is not None:
            self.server.shutdown()
            self.server.server_close()

    def files_asked(self) -> list[tuple[str, str, str]]:
        """Requests for bytes of files, not for listings."""
        return [one for one in self.asked if one[0] == "GET" and not one[1].startswith("api/")]

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        url = urlsplit(request.path)
        path = unquote(url.path).lstrip("/")
        self.asked.append((request.command, path, request.headers.get("Range", "")))
        login = request.headers.get("Authorization")
        cdn = re.fullmatch(r"cdn/(.+?)/resolve/([0-9a-f]{40})/(.+)", path)
        if cdn:
            assert login is None, "the hub's token went to another host"
            return self.send(request, path, self.repositories[cdn[1]][cdn[2]][cdn[3]])
        if self.token and login != f"Bearer {self.token}":
            return self.reply(request, 403, b"{}", {"X-Error-Code": "GatedRepo"})
        listing = re.fullmatch(r"api/models/(.+)/revision/(.+)", path)
        if listing:
            assert parse_qs(url.query)["blobs"] == ["true"]
            return self.list_files(request, *listing.groups())
        tree = re.fullmatch(r"api/models/(.+)/tree/([0-9a-f]{40})", path)
        if tree:
            return self.list_tree(request, *tree.groups())
        file = re.fullmatch(r"(.+?)/resolve/([0-9a-f]{40})/(.+)", path)
        if file:
            found = self.repositories.get(file[1], {}).get(file[2], {}).get(file[3])
            if found is None:
                return self.reply(request, 404, b"", {"X-Error-Code": "EntryNotFound"})
            commit = {"X-Repo-Commit": file[2]}
            if len(data_of(found)) < LARGE:
                return self.send(request, path, found, commit)
            # Another host serves these, as of the real hub: here the same port by another name.
            elsewhere = self.address.replace("127.0.0.1", "localhost")
            linked = {"X-Linked-Size": str(len(data_of(found))), "X-Linked-Etag": hashes(found)[0]}
            location = {"Location": f"{elsewhere}/cdn/{path}"}
            return self.reply(request, 302, b"", commit | linked | location)
        if path in self.web:
            return self.send(request, path, self.web[path])
        return self.reply(request, 404, b"")

    def list_files(self, request: BaseHTTPRequestHandler, name: str, revision: str) -> None:
        commits = self.repositories.get(name, {})
        commit = list(commits)[-1] if revision == "main" and commits else revision
        if commit not in commits:
            return self.reply(request, 404, b"", {"X-Error-Code": "RepoNotFound"})
        siblings = []
        for file, content in commits[commit].items():
            size, (sha, blob) = len(data_of(content)), hashes(content)
            one = {"rfilename": file, "size": size, "blobId": blob}
            lfs = {"lfs": {"sha256": sha, "size": size, "pointerSize": 134}}
            siblings.append(one | lfs if size >= LARGE else one)
        told = {"id": name, "sha": self.wrong_commit or commit, "siblings": siblings}
        return self.reply(request, 200, self.listing or json.dumps(told).encode())

    def list_tree(self, request: BaseHTTPRequestHandler, name: str, commit: str) -> None:
        """What snapshot_download asks for, after the listing with the hashes."""
        entries = []
        for path, content in self.repositories[name][commit].items():
            size, (sha, blob) = len(data_of(content)), hashes(content)
            one = {"type": "file", "path": path, "size": size, "oid": blob}
            lfs = {"lfs": {"oid": sha, "size": size, "pointerSize": 134}}
            entries.append(one | lfs if size >= LARGE else one)
        return self.reply(request, 200, json.dumps(entries).encode())

    def send(
        self,
        request: BaseHTTPRequestHandler,
        path: str,
        content: Content,
        more: dict[str, str] | None = None,
    ) -> None:
        data = self.served_instead.get(path.rpartition("/")[2], data_of(content))
        wanted = re.fullmatch(r"bytes=(\d+)-", request.headers.get("Range", "") * self.ranges)
        start = int(wanted[1]) if wanted else 0
        headers = {"ETag": f'"{hashes(content)[0]}"', "Accept-Ranges": "bytes"} | (more or {})
        if wanted:
            headers["Content-Range"] = f"bytes {start}-{len(data) - 1}/{len(data)}"
        left = len(data) - start
        sent = request.command == "GET" and len(data) >= LARGE
        cut = self.cuts.pop(0) if sent and self.cuts and self.cuts[0] < left else None
        self.reply(request, 206 if wanted else 200, data[start:], headers, cut)

    def reply(
        self,
        request: BaseHTTPRequestHandler,
        status: int,
        body: Data,
        headers: dict[str, str] | None = None,
        cut: int | None = None,
    ) -> None:
        request.send_response(status)
        for name, value in (headers or {}).items():
            request.send_header(name, value)
        request.send_header("Content-Length", str(len(body)))
        request.end_headers()
        if request.command == "HEAD":
            return
        if cut is not None and cut < len(body):
            body = body[:cut]
            request.close_connection = True
        request.wfile.write(body)
        request.wfile.flush()
        self.sent += len(body)


MIT = Licence("MIT", "https://example.org/mit")


FILES: dict[str, Content] = {
    "config.json": b'{"model": "toy"}',
    "deep/weights.safetensors": random.Random(1).randbytes(20_000),
    "README.md": b"not asked for",
}


def entry(*sources: WeightsSource, name: str = "toy", **more: object) -> Weights:
    """An entry of the table."""
    return Weights(name, "tests", ("--generator",), 0.1, sources, "generator", **more)  # type: ignore[arg-type]
