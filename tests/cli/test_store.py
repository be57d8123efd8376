"""`recast store`: what is there, why, and what nobody needs."""

from __future__ import annotations

from pathlib import Path

import pytest

from recast.cli.main import main
from recast.core import Store


def write(folder: Path) -> None:
    (folder / "file").write_bytes(b"x" * 2_000_000)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """A scene that an actor was made from, which a run uses; and a scene that nobody uses."""
    made = Store(tmp_path / "store")
    scene = made.make("scenes", {"log": "abc", "seed": 7}, write, name="own \x1b[31mstreet")
    actor = made.make("actors", {"scene": scene.reference}, write, name="car")
    made.make("scenes", {"log": "abc", "seed": 8}, write, name="forgotten")
    (tmp_path / "run").mkdir()
    made.refer(tmp_path / "run", (actor.reference,))
    return made


def told(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["store", *words]) == 0
    text = capsys.readouterr().out
    assert all(len(line) <= 80 for line in text.splitlines())
    return " ".join(text.split())


def test_list(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    text = told(capsys, "list", str(store.root))
    assert "artefacts: 3, 6.0 MB; run folders: 1" in text
    assert "forgotten" in text and r"own \x1b[31mstreet" in text


def test_why(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    actor = store.find("actors", {"scene": next(store.artefacts()).reference})
    key = next(one.record.key for one in store.artefacts() if one.record.kind == "actors")
    text = told(capsys, "why", str(store.root), key[:8])
    assert "car" in text and "street" in text and "seed: 7" in text and "seed: 8" not in text
    assert actor is None or actor.record.key == key


def test_prune(store: Store, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    partial = store.root / "scenes" / f".{'0' * 32}.partial"
    partial.mkdir()
    young = told(capsys, "prune", str(store.root))
    assert "0 artefacts (0.0 MB) and 1 leftovers" in young  # of today: a run may be at work
    all_ages = ("prune", str(store.root), "--older-than", "0")
    text = told(capsys, *all_ages)
    assert "1 artefacts (2.0 MB) and 1 leftovers can be removed with --yes" in text
    assert len(list(store.artefacts())) == 3 and partial.exists()
    assert "removed" in told(capsys, *all_ages, "--yes")
    assert {one.record.name for one in store.artefacts()} == {"own \x1b[31mstreet", "car"}
    assert not partial.exists()
    (tmp_path / "run").rmdir()
    assert "2 artefacts" in told(capsys, *all_ages, "--yes")
    assert list(store.artefacts()) == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("list", "nowhere"), "is not a local store"),
        (("why", "nowhere", "abc"), "is not a local store"),
        (("prune", "s3://bucket/store"), "is not a local store"),
    ],
)
def test_no_store(words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["store", *words]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert said in line


def test_a_key_of_none_and_of_several(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    for key in ("zzz", ""):
        assert main(["store", "why", str(store.root), key]) == 2
        [line] = capsys.readouterr().err.splitlines()
        assert "no artefact has this key" in line
