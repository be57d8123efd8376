"""Weights over a network that breaks: cut, wrong, missing, full, killed, and offline afterwards."""

from __future__ import annotations

import errno
import shutil
from collections import namedtuple
from dataclasses import replace
from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast.core.plugins import GENERATORS, PLANNERS, SEGMENTERS
from recast.pretrained import VQA_SCORERS
from recast.weights import PUBLISHED, Licence, Weights, WeightsSource, weights_folder
from recast.weights.fetch import fetch
from recast.weights.table import opened, read_weights_record, verify
from support.children import refused_from
from support.moments import killed_before
from weights.hub import FILES, MIT, Hub, data_of, entry, sha256

LARGE = "deep/weights.safetensors"
WHOLE = {name: data_of(FILES[name]) for name in ("config.json", LARGE)}


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "weights.json"
    }


def refusal(weights: Weights) -> str:
    with pytest.raises(InputError) as caught:
        fetch(weights)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_files_are_fetched_once_and_recorded(hub: Hub, toy: Weights) -> None:
    seen: list[tuple[str, int, int | None]] = []
    folder = fetch(toy, progress=lambda *told: seen.append(told))
    assert folder == weights_folder("toy") and contents(folder) == WHOLE
    assert seen[-1] == ("someone/toy", 20_016, 20_016)
    commit = next(iter(hub.repositories["someone/toy"]))
    record = read_weights_record(folder)
    assert record.revisions == {"someone/toy": commit}
    assert {name: file.sha256 for name, file in record.files.items()} == {
        name: sha256(data) for name, data in WHOLE.items()
    }
    assert sorted(record.fetched) == [
        f"https://huggingface.co/someone/toy/resolve/{commit}/{name}" for name in sorted(WHOLE)
    ]
    asked = len(hub.asked)
    hub.stop()
    assert fetch(toy) == folder and opened(toy) == folder
    assert len(hub.asked) == asked


GONE = [0] * 6  # more than are tried again in one process


def test_a_cut_transfer_goes_on_in_the_same_process(hub: Hub, toy: Weights) -> None:
    hub.cuts = [6_000, 6_000]
    assert contents(fetch(toy)) == WHOLE
    ranges = [asked[2] for asked in hub.files_asked() if asked[1].startswith("cdn/")]
    assert ranges == ["", "bytes=6000-", "bytes=12000-"]


def test_files_that_came_are_kept_for_the_next_call(hub: Hub, toy: Weights) -> None:
    hub.cuts = [9_000, *GONE]
    assert "does not answer" in refusal(toy)
    assert not weights_folder("toy").exists()
    hub.cuts = []
    hub.asked.clear()
    assert contents(fetch(toy)) == WHOLE
    assert [path.rpartition("/")[2] for _, path, _ in hub.files_asked()] == ["weights.safetensors"]


def test_a_branch_that_moves_meanwhile_is_followed(hub: Hub, toy: Weights) -> None:
    hub.cuts = [9_000, *GONE]
    refusal(toy)
    hub.cuts = []
    newer = {"config.json": b"{}", LARGE: b"other" * 1000}
    second = hub.commit("someone/toy", newer)
    assert contents(fetch(toy)) == newer
    assert read_weights_record(opened(toy)).revisions == {"someone/toy": second}


@pytest.mark.parametrize("ranges", [True, False])
def test_a_file_of_another_host_goes_on_with_the_next_call(hub: Hub, ranges: bool) -> None:
    data = WHOLE[LARGE]
    hub.web["example.org/a/b.bin"] = data
    web = entry(WeightsSource("https://example.org/a", ("b.bin",), MIT))
    hub.cuts, hub.ranges = [9_000, *GONE], ranges
    assert "does not answer" in refusal(web)
    hub.cuts, hub.sent = [], 0
    assert contents(fetch(web)) == {"b.bin": data}
    assert hub.files_asked()[-1][2] == ("bytes=9000-" if ranges else "")
    assert hub.sent == (11_000 if ranges else 20_000)


@pytest.mark.parametrize("name", sorted(WHOLE))
def test_wrong_bytes_are_refused_and_removed(hub: Hub, toy: Weights, name: str) -> None:
    right = WHOLE[name]
    hub.served_instead[name.rpartition("/")[2]] = bytes([right[0] ^ 1]) + right[1:]
    said = refusal(toy)
    assert "hash" in said or "SHA-256" in said
    assert not weights_folder("toy").exists()
    assert not list(weights_folder(".toy.partial").rglob(f".{Path(name).name}.partial"))
    hub.served_instead.clear()
    assert contents(fetch(toy)) == WHOLE


def test_a_pinned_hash_goes_before_the_hub(hub: Hub, toy: Weights) -> None:
    pinned = entry(replace(toy.sources[0], files=(LARGE,), sha256={LARGE: "0" * 64}))
    assert f"on the server, recast pins {'0' * 20}" in refusal(pinned)
    assert hub.files_asked() == []


def test_a_pinned_commit_is_asked_for_and_checked(hub: Hub, toy: Weights) -> None:
    first = next(iter(hub.repositories["someone/toy"]))
    hub.commit("someone/toy", {"config.json": b"{}", LARGE: b"other" * 1000})
    pinned = entry(replace(toy.sources[0], revision=first))
    assert pinned.pinned and not toy.pinned
    hub.wrong_commit = "f" * 40
    assert "answers with commit ffff" in refusal(pinned)
    hub.wrong_commit = ""
    assert contents(fetch(pinned)) == WHOLE


def test_a_new_pin_makes_older_files_another_version(
    hub: Hub, toy: Weights, monkeypatch: pytest.MonkeyPatch
) -> None:
    fetch(toy)
    second = hub.commit("someone/toy", {"config.json": b"{}", LARGE: b"other" * 1000})
    pinned = entry(replace(toy.sources[0], revision=second))
    with pytest.raises(InputError, match=r"another version.*run `recast weights get toy`"):
        opened(pinned)
    assert contents(fetch(pinned)) == {"config.json": b"{}", LARGE: b"other" * 1000}
    assert opened(pinned) == weights_folder("toy")
    assert {path.name for path in weights_folder().iterdir()} == {"toy", ".toy.verified.json"}


def test_a_missing_file_repository_or_answer(
    hub: Hub, toy: Weights, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = toy.sources[0]
    said = refusal(entry(replace(source, files=("gone.json",))))
    assert "someone/toy: gone.json: is not in the repository at main" in said
    assert "does not exist" in refusal(entry(replace(source, where="someone/gone")))
    assert "does not exist" in refusal(entry(WeightsSource("https://example.org", ("gone",), MIT)))
    hub.stop()
    said = refusal(toy)
    assert "does not answer (" in said and "check the connection" in said
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    assert "HF_HUB_OFFLINE" in refusal(toy)


def listing(name: str = "config.json", size: str = "2") -> bytes:
    told = '{"id": "someone/toy", "sha": "%s", "siblings": [{"rfilename": "%s", "size": %s}]}'
    return (told % ("0" * 40, name, size)).encode()


UNUSABLE = "server: gives an answer that cannot be used"


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (b"[" * 100_000, UNUSABLE),
        (
            b'{"id": "a", "sha": ' + b"[" * 900 + b"]" * 900 + b"}",
            "commit: Input should be",
        ),
        (listing(name="\\ud800.json"), "name: Input should be a valid string, unable to parse"),
        (listing(name="x" * 2000), "name: String should have at most 1000"),
        (listing(size="1" + "0" * 400), "size: Input should be less than or equal to"),
        (listing(size="1" + "0" * 5000), UNUSABLE),
        (listing(size="1e999"), "size: Input should be a finite number"),
        (listing(size="-1"), "size: Input should be greater"),
        (b"\xff{}", UNUSABLE),
        (b"[]", UNUSABLE),
        (b"{}", UNUSABLE),
    ],
)
def test_hostile_listings_are_one_line(hub: Hub, toy: Weights, answer: bytes, said: str) -> None:
    hub.listing = answer
    assert said in refusal(toy)
    assert not weights_folder("toy").exists()


def test_a_disk_that_is_too_small_is_told_before_the_first_byte(
    hub: Hub, toy: Weights, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(1, 1, 20_000))
    assert "GB free, toy needs" in refusal(toy)
    assert hub.files_asked() == []
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(1, 1, 20_016))
    assert contents(fetch(toy)) == WHOLE


def test_a_disk_that_fills_up_at_any_change(hub: Hub, toy: Weights) -> None:
    """Then the same command goes on, once there is room. Tried at every third change."""
    change, went_on = -2, True
    while went_on:
        change += 3
        shutil.rmtree(weights_folder(), ignore_errors=True)
        went_on = refused_from(change, errno.ENOSPC, lambda: fetch(toy), weights_folder())
        assert contents(fetch(toy)) == WHOLE
        verify(opened(toy), read_weights_record(opened(toy)))
    assert change > 8


def test_a_kill_at_any_change(hub: Hub, toy: Weights) -> None:
    """The next call finishes it; what has the final name is whole at every moment."""
    change, killed = 0, True
    while killed:
        shutil.rmtree(weights_folder(), ignore_errors=True)
        killed = killed_before(change, lambda: fetch(toy), weights_folder())
        if weights_folder("toy").exists():
            assert contents(weights_folder("toy")) == WHOLE
        assert contents(fetch(toy)) == WHOLE
        change += 1
    assert change > 8


def test_a_changed_byte_is_found(hub: Hub, toy: Weights) -> None:
    folder = fetch(toy)
    path = folder / LARGE
    path.write_bytes(WHOLE[LARGE][:-1] + b"?")
    with pytest.raises(InputError, match=r"changed after toy was downloaded; remove .* get toy"):
        opened(toy)
    with pytest.raises(InputError, match="changed after toy was downloaded"):
        fetch(toy)
    path.unlink()
    with pytest.raises(InputError, match="this file is missing"):
        opened(toy)


def test_unchanged_files_are_not_read_at_every_use(
    hub: Hub, toy: Weights, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = fetch(toy)
    note = folder.with_name(".toy.verified.json")
    monkeypatch.setattr("recast.weights.table.file_record", lambda path: pytest.fail("read"))
    assert opened(toy) == folder
    note.unlink()
    with pytest.raises(pytest.fail.Exception):
        opened(toy)
    monkeypatch.undo()
    monkeypatch.setenv("RECAST_WEIGHTS", str(folder.parent))
    for damage in ("[]", "{", '{"config.json": 3}'):
        note.write_text(damage)
        assert opened(toy) == folder
    (folder / "config.json").touch()
    before = note.read_bytes()
    assert opened(toy) == folder and note.read_bytes() != before


def test_mirrors(hub: Hub, toy: Weights, monkeypatch: pytest.MonkeyPatch) -> None:
    """One for all hosts; HF_ENDPOINT for the hub alone. The record names the publisher."""
    other = Hub(repositories=hub.repositories)
    other.start()
    monkeypatch.setenv("HF_ENDPOINT", other.address)
    both = entry(*toy.sources, WeightsSource("https://example.org/a", ("b.bin",), MIT))
    hub.web["example.org/a/b.bin"] = b"web"
    folder = fetch(both)
    assert other.asked == [] and (folder / "b.bin").read_bytes() == b"web"
    assert "https://example.org/a/b.bin" in read_weights_record(folder).fetched
    record = (folder / "weights.json").read_bytes()
    shutil.rmtree(weights_folder())
    monkeypatch.delenv("RECAST_WEIGHTS_MIRROR")
    asked = len(hub.asked)
    fetch(toy)
    assert len(hub.asked) == asked and other.files_asked()
    assert record.count(b"127.0.0.1") == 0
    other.stop()


def test_a_gated_repository_asks_for_a_login(
    hub: Hub, toy: Weights, monkeypatch: pytest.MonkeyPatch
) -> None:
    hub.token = "hf_secret"
    said = refusal(toy)
    assert "asks for a login" in said and "https://huggingface.co/someone/toy" in said
    monkeypatch.setenv("HF_TOKEN", "hf_secret")
    assert contents(fetch(toy)) == WHOLE
    assert "hf_secret" not in (weights_folder("toy") / "weights.json").read_text()


def test_terms_must_be_accepted_before_the_first_request(hub: Hub, toy: Weights) -> None:
    terms = Licence("CC BY-NC 4.0", "https://example.org/terms", restricted=True)
    weights = entry(replace(toy.sources[0], licence=terms))
    said = refusal(weights)
    assert "CC BY-NC 4.0, https://example.org/terms" in said and "`accept_licence`" in said
    assert hub.asked == []
    fetch(weights, accepted=True)
    asked = len(hub.asked)
    assert fetch(weights) == weights_folder("toy") and len(hub.asked) == asked


def test_names_of_a_hub_never_leave_the_folder(hub: Hub, toy: Weights) -> None:
    hub.commit("someone/toy", FILES | {"deep/../../../evil.safetensors": b"x" * 2000})
    assert "not a file inside" in refusal(toy)
    assert not (weights_folder().parent / "evil.safetensors").exists()


def test_two_processes_do_not_fetch_the_same(hub: Hub, toy: Weights) -> None:
    from recast.core.files import alone_in

    partial = weights_folder(".toy.partial")
    partial.mkdir(parents=True)
    with alone_in(partial):
        assert "another process is at work" in refusal(toy)


def test_the_table_is_consistent() -> None:
    kinds = {"", *(kind.kind for kind in (GENERATORS, PLANNERS, SEGMENTERS, VQA_SCORERS))}
    for name, weights in PUBLISHED.items():
        assert weights.name == name and weights.gigabytes > 0 and weights.options
        assert weights.part in kinds
        assert set(weights.converted) <= {f for s in weights.sources for f in s.files}
        for source in weights.sources:
            assert source.licence.link.startswith("https://")
            assert len(source.revision or "0" * 40) == 40
            assert set(source.sha256) <= set(source.files)
            assert all(len(digest) == 64 for digest in source.sha256.values())
            assert source.repository or source.where.startswith("https://")
    files = [one.sha256.items() for w in PUBLISHED.values() for one in w.sources]
    for name, digest in (item for items in files for item in items):
        beginning = name.rpartition(".")[0].rpartition("-")[2]
        if len(beginning) == 8 and set(beginning) <= set("0123456789abcdef"):  # torch hub
            assert digest.startswith(beginning)
