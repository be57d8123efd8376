"""A store in object storage: an S3-compatible server on loopback, and fsspec's memory."""

from __future__ import annotations

from pathlib import Path

import pytest
from upath import UPath

from recast.core import Store, open_store
from recast.core.artefact import CACHE_VARIABLE
from recast.core.errors import InputError

INPUTS = {"log": "abc"}


def write(folder: Path) -> None:
    (folder / "deep").mkdir()
    (folder / "deep" / "file.bin").write_bytes(bytes(range(256)))


def on(machine: Path, place: str, monkeypatch: pytest.MonkeyPatch) -> Store:
    """The store as another machine sees it: with a cache of its own."""
    monkeypatch.setenv(CACHE_VARIABLE, str(machine))
    return open_store(place)


def test_what_one_machine_made_another_finds(
    bucket: UPath, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = f"{str(bucket).rstrip(chr(47))}/store"
    made = on(tmp_path / "a", place, monkeypatch).make("scenes", INPUTS, write, name="x")
    assert made.fresh
    other = on(tmp_path / "b", place, monkeypatch)
    found = other.make("scenes", INPUTS, lambda folder: pytest.fail("made twice"), name="x")
    assert not found.fresh
    assert (found.path / "deep" / "file.bin").read_bytes() == bytes(range(256))


def test_a_lost_file_is_one_line(
    bucket: UPath, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = f"{str(bucket).rstrip(chr(47))}/store"
    made = on(tmp_path / "a", place, monkeypatch).make("scenes", INPUTS, write, name="x")
    (bucket / "store" / made.reference / "data" / "deep" / "file.bin").write_bytes(b"cut")
    with pytest.raises(InputError, match="has 3 bytes, not 256"):
        on(tmp_path / "b", place, monkeypatch).find("scenes", INPUTS)


def test_a_store_that_does_not_answer_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cut(*_: object, **__: object) -> None:
        raise ConnectionError("the line is dead")

    store = on(tmp_path / "a", "memory://recast/dead", monkeypatch)
    monkeypatch.setattr("fsspec.implementations.memory.MemoryFileSystem.info", cut)
    with pytest.raises(InputError, match=r"the line is dead.*check the address"):
        store.make("scenes", INPUTS, lambda folder: pytest.fail("made"), name="x")


def test_memory_is_a_place_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    on(tmp_path / "a", "memory://recast/store", monkeypatch).make("scenes", INPUTS, write, name="x")
    assert on(tmp_path / "b", "memory://recast/store", monkeypatch).find("scenes", INPUTS)


def test_an_unknown_kind_of_address_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="moon"):
        open_store("moon://base/store")
