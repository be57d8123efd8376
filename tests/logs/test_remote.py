"""Logs in object storage: copied once, whole or not at all, and one line if that fails."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fsspec.implementations.memory import MemoryFileSystem
from moto.server import ThreadedMotoServer
from upath import UPath

from recast.cli.main import main
from recast.core.artefact import CACHE_VARIABLE, cache_folder
from recast.core.errors import InputError
from recast.logs import load_log, write_log
from recast.logs.load import local_folder
from support.small_log import small_log

ADDRESS = "memory://bucket/drive"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("remote") / "log"
    write_log(small_log(np.random.default_rng(7)), out)
    return out


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def _upload(folder: Path, remote: UPath) -> None:
    for path in folder.rglob("*"):
        if path.is_file():
            target = remote / path.relative_to(folder).as_posix()
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(path.read_bytes())


@pytest.fixture
def memory(folder: Path) -> Iterator[UPath]:
    """The log in fsspec's file system in memory."""
    _upload(folder, UPath(ADDRESS))
    yield UPath(ADDRESS)
    MemoryFileSystem.store.clear()
    MemoryFileSystem.pseudo_dirs[:] = [""]


@pytest.fixture(scope="module")
def s3(folder: Path) -> Iterator[dict[str, Any]]:
    """Options of an S3 server on this machine whose bucket holds the log."""
    server = ThreadedMotoServer("127.0.0.1", 0)
    server.start()
    host, port = server.get_host_and_port()
    options = {"key": "a", "secret": "b", "endpoint_url": f"http://{host}:{port}"}
    UPath("s3://drives", **options).mkdir()
    _upload(folder, UPath("s3://drives/first", **options))
    yield options
    server.stop()


def _same(copy: Path | None, folder: Path) -> bool:
    assert copy is not None
    return {p.name: p.read_bytes() for p in copy.iterdir()} == {
        p.name: p.read_bytes() for p in folder.iterdir()
    }


def test_a_log_in_s3(
    s3: dict[str, Any],
    folder: Path,
    cache: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    remote = UPath("s3://drives/first", **s3)
    log = load_log(remote)
    assert log.origin is not None and log.origin.is_relative_to(cache / "logs")
    assert _same(log.origin, folder)
    np.testing.assert_array_equal(
        log.cameras["front"].images[0], load_log(folder).cameras["front"].images[0]
    )
    with pytest.raises(InputError, match=r"s3://drives/none: log\.json: is missing"):
        load_log(UPath("s3://drives/none", **s3))
    with pytest.raises(InputError, match="s3://nowhere/log: "):
        load_log(UPath("s3://nowhere/log", **s3))
    # The command finds endpoint and credentials in the environment, as all AWS tools do.
    for name, value in {
        "AWS_ENDPOINT_URL": s3["endpoint_url"],
        "AWS_ACCESS_KEY_ID": "a",
        "AWS_SECRET_ACCESS_KEY": "b",
    }.items():
        monkeypatch.setenv(name, value)
    assert main(["log", "info", "s3://drives/first", "--json"]) == 0
    assert '"name": "' in capsys.readouterr().out


def test_a_server_that_does_not_answer_is_one_line() -> None:
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        port = closed.getsockname()[1]  # no program listens there
        endpoint, once = f"http://127.0.0.1:{port}", {"retries": {"max_attempts": 0}}
        remote = UPath(
            "s3://drives/first", key="a", secret="b", endpoint_url=endpoint, config_kwargs=once
        )
        with pytest.raises(InputError, match=r"s3://drives/first: files: cannot be used") as error:
            load_log(remote)
    assert "\n" not in str(error.value)


def test_it_is_copied_once_and_again_when_it_changed(
    memory: UPath, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[int, int]] = []
    first = local_folder(ADDRESS + "/", lambda done, total: told.append((done, total)))
    size = sum(path.stat().st_size for path in folder.iterdir())
    assert told[0] == (0, size) and told[-1] == (size, size)
    assert _same(first, folder)
    told.clear()
    assert local_folder(memory, lambda *call: told.append(call)) == first
    assert told == []
    text = (memory / "log.json").read_text()
    (memory / "log.json").write_text(re.sub('"name": "[^"]*"', '"name": "changed"', text, count=1))
    second = load_log(ADDRESS)
    assert second.name == "changed" and second.origin not in (None, first)
    assert _same(first, folder)


def test_a_failed_copy_leaves_nothing_and_the_next_one_succeeds(
    memory: UPath, folder: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaking(self: MemoryFileSystem, path: str, *more: Any, **options: Any) -> Any:
        if path.endswith("ncore.json"):
            raise ConnectionResetError("reset\nby peer")
        return opened(self, path, *more, **options)

    opened = MemoryFileSystem.open
    monkeypatch.setattr(MemoryFileSystem, "open", breaking)
    with pytest.raises(InputError, match=r"ncore\.json: cannot be used \(Conn.*reset by peer"):
        load_log(ADDRESS)
    assert [path for path in cache.rglob("*") if path.is_file()] == []
    monkeypatch.undo()
    monkeypatch.setenv(CACHE_VARIABLE, str(cache))
    assert _same(load_log(ADDRESS).origin, folder)


def test_a_file_of_another_size_is_refused(
    memory: UPath, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def longer(self: MemoryFileSystem, *more: Any, **options: Any) -> dict[str, Any]:
        listed = found(self, *more, **options)
        return {path: {**about, "size": about["size"] + 1} for path, about in listed.items()}

    found = MemoryFileSystem.find
    monkeypatch.setattr(MemoryFileSystem, "find", longer)
    with pytest.raises(InputError, match=r"bytes arrived, \d+ were expected; load it again"):
        load_log(ADDRESS)
    assert [path for path in cache.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("memory://bucket/none", r"memory://bucket/none: log\.json: is missing"),
        ("nonesuch://x/y", r"nonesuch://x/y: address: cannot be used \(ValueError"),
        ("gs://x/y", r"gs://x/y: address: .*gcsfs"),
    ],
)
def test_addresses_without_a_log(address: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        load_log(address)
    assert "\n" not in str(error.value)


def test_names_that_lead_out_of_the_folder_are_refused(
    memory: UPath, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def leading_out(self: MemoryFileSystem, *more: Any, **options: Any) -> dict[str, Any]:
        about = found(self, *more, **options)["/bucket/drive/log.json"]
        return {f"/bucket/drive/{name}": about for name in ("log.json", "../../../evil")}

    found = MemoryFileSystem.find
    monkeypatch.setattr(MemoryFileSystem, "find", leading_out)
    with pytest.raises(InputError, match="is not a file inside of"):
        load_log(ADDRESS)
    assert not list(cache.parent.rglob("evil"))


def test_the_cache_is_in_the_home_folder_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(CACHE_VARIABLE)
    assert cache_folder() == Path.home() / ".cache" / "recast"
    monkeypatch.setenv(CACHE_VARIABLE, "~/elsewhere")
    assert cache_folder() == Path.home() / "elsewhere"


def test_local_addresses_are_read_where_they_are(folder: Path, cache: Path) -> None:
    for address in (folder, str(folder), folder.as_uri(), UPath(folder), UPath(folder.as_uri())):
        assert load_log(address).origin == folder
    assert not cache.exists()
