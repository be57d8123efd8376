"""The store: made once, whole or not at all, and nobody's bytes are trusted that changed."""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import shutil
import stat
import time
from pathlib import Path

import pytest

from recast.core import Artefact, Store, files
from recast.core.artefact import ParcelDepot, artefact_key, pack, unpack
from recast.core.errors import InputError
from recast.core.store import NotInStoreError

INPUTS = {"log": "abc", "seed": 3}


def write(folder: Path, text: str = "whole") -> None:
    (folder / "deep").mkdir(exist_ok=True)
    (folder / "deep" / "file.txt").write_text(text)


def make(store: Store, inputs: dict[str, object] | None = None, kind: str = "scenes") -> Artefact:
    return store.make(kind, inputs or INPUTS, write, name="a thing")


def test_what_is_there_is_not_made_again(tmp_path: Path) -> None:
    first = make(Store(tmp_path / "store"))
    assert first.fresh and (first.path / "deep" / "file.txt").read_text() == "whole"
    again = make(Store(tmp_path / "store"))
    assert not again.fresh and again.reference == first.reference
    assert make(Store(tmp_path / "store"), {**INPUTS, "seed": 4}).reference != first.reference
    assert Store(tmp_path / "store").find("scenes", INPUTS) is not None
    assert Store(tmp_path / "store").find("actors", INPUTS) is None


def test_the_key_is_that_of_the_inputs_in_any_order() -> None:
    assert artefact_key("scenes", {"a": 1, "b": 2}) == artefact_key("scenes", {"b": 2, "a": 1})
    assert artefact_key("scenes", {"a": 1}) != artefact_key("actors", {"a": 1})


def test_what_fails_leaves_nothing_and_what_resumes_goes_on(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")

    def fail(folder: Path) -> None:
        write(folder, "half")
        raise RuntimeError("killed")

    for resumes in (False, True):
        with pytest.raises(RuntimeError):
            store.make("scenes", INPUTS, fail, name="x", resumes=resumes)
        assert store.find("scenes", INPUTS) is None
        assert list(store.artefacts()) == []
    seen = []
    store.make(
        "scenes", INPUTS, lambda f: seen.append((f / "deep").exists()), name="x", resumes=True
    )
    assert seen == [True]


def test_changed_and_lost_files_are_one_line(tmp_path: Path) -> None:
    made = make(Store(tmp_path / "store"))
    file = made.path / "deep" / "file.txt"
    file.write_text("wholE")
    with pytest.raises(InputError, match="changed after the artefact was made"):
        Store(tmp_path / "store").find("scenes", INPUTS)
    file.unlink()
    with pytest.raises(InputError, match=r"file\.txt: artefact: this file was deleted"):
        make(Store(tmp_path / "store"))
    (made.folder / "artefact.json").unlink()  # half deleted: it does not count as finished
    assert make(Store(tmp_path / "store")).fresh
    assert file.read_text() == "whole"


def test_a_record_that_leads_out_of_its_folder_is_refused(tmp_path: Path) -> None:
    made = make(Store(tmp_path / "store"))
    record = json.loads((made.folder / "artefact.json").read_text())
    record["files"]["../../../victim"] = {"size": 1, "hash": "0"}
    (made.folder / "artefact.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match="not a file inside"):
        Store(tmp_path / "store").find("scenes", INPUTS)


@pytest.mark.parametrize("file", ["store.json", "artefact"])
def test_a_newer_version_is_refused(tmp_path: Path, file: str) -> None:
    made = make(Store(tmp_path / "store"))
    path = (
        tmp_path / "store" / "store.json" if file == "store.json" else made.folder / "artefact.json"
    )
    path.write_text(json.dumps({**json.loads(path.read_text()), "version": 9}))
    with pytest.raises(InputError, match="version: is 9"):
        make(Store(tmp_path / "store"))
    assert (made.path / "deep" / "file.txt").read_text() == "whole"


def test_a_folder_of_other_things_is_no_store(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"store\.json: is missing"):
        Store(tmp_path)
    with pytest.raises(InputError, match="is a file"):
        Store(tmp_path / "notes.txt")


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_a_read_only_store_finds_and_refuses_to_make(tmp_path: Path) -> None:
    make(Store(tmp_path / "store"))
    (tmp_path / "store" / "scenes").chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        assert not make(Store(tmp_path / "store")).fresh
        with pytest.raises(InputError, match="permission denied"):
            make(Store(tmp_path / "store"), {"other": 1})
    finally:
        (tmp_path / "store" / "scenes").chmod(0o755)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS])
def test_a_full_or_read_only_disk_is_one_line(
    tmp_path: Path, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path / "store")
    make(store)

    def full(folder: Path) -> None:
        with files.disk_errors(folder):
            raise OSError(number, os.strerror(number), str(folder / "file"))

    with pytest.raises(InputError, match="disk"):
        store.make("scenes", {"other": 1}, full, name="x")
    assert [one.record.inputs for one in store.artefacts()] == [INPUTS]


def _make_slowly(root: Path, log: Path) -> None:
    def slowly(folder: Path) -> None:
        with log.open("a") as stream:
            stream.write("made\n")
        time.sleep(0.3)
        write(folder)

    Store(root).make("scenes", INPUTS, slowly, name="x")


def test_two_processes_make_it_once(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    arguments = (tmp_path / "store", tmp_path / "log")
    both = [context.Process(target=_make_slowly, args=arguments) for _ in range(2)]
    for one in both:
        one.start()
    for one in both:
        one.join()
    assert [one.exitcode for one in both] == [0, 0]
    assert (tmp_path / "log").read_text() == "made\n"


def _die_while_making(root: Path) -> None:
    Store(root).make("scenes", INPUTS, lambda folder: os._exit(9), name="x")


def test_a_killed_maker_gives_its_lock_back(tmp_path: Path) -> None:
    child = multiprocessing.get_context("spawn").Process(
        target=_die_while_making, args=(tmp_path / "store",)
    )
    child.start()
    child.join()
    assert child.exitcode == 9
    store = Store(tmp_path / "store")
    assert len(store.leftovers()) == 1
    assert make(store).fresh
    assert store.leftovers() == []


def test_what_no_run_refers_to_is_unused(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    scene = make(store)
    actor = make(store, {"scene": scene.reference}, "actors")
    other = make(store, {"seed": 9})
    run = tmp_path / "run"
    run.mkdir()
    store.refer(run, (actor.reference,))
    assert [one.reference for one in store.unused()] == [other.reference]
    moved = tmp_path / "elsewhere"  # store and run together, as on another machine
    moved.mkdir()
    for name in ("store", "run"):
        shutil.copytree(tmp_path / name, moved / name)
    assert [one.reference for one in Store(moved / "store").unused()] == [other.reference]
    shutil.rmtree(run)
    assert len(store.unused()) == 3
    store.remove(other)
    assert len(list(store.artefacts())) == 2


def test_parcels_travel_and_come_back_as_they_were(tmp_path: Path) -> None:
    made = make(Store(tmp_path / "here"))
    depot = ParcelDepot({made.reference: pack(made)}, lambda ticket: ticket)  # type: ignore[arg-type,return-value]
    there = Store(tmp_path / "there", depot)
    found = there.make("scenes", INPUTS, lambda folder: pytest.fail("made twice"), name="x")
    assert (found.path / "deep" / "file.txt").read_text() == "whole"
    assert Store(tmp_path / "third").take(made.reference, pack(found)).reference == made.reference
    with pytest.raises(InputError, match="cannot be unpacked"):
        unpack(b"garbage", tmp_path / "fourth")


def test_a_store_that_only_finds_makes_nothing(tmp_path: Path) -> None:
    make(Store(tmp_path / "store"))
    finds = Store(tmp_path / "store", only_finds=True)
    assert not make(finds).fresh
    with pytest.raises(NotInStoreError):
        make(finds, {"other": 1})
