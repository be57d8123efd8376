from __future__ import annotations

import errno
from pathlib import Path

import pytest

from recast import storage
from recast.errors import InputError


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "value.json"
    storage.write_json(target, {"a": 1})
    with pytest.raises(RuntimeError), storage.atomic_file(target) as partial:
        partial.write_text("half")
        raise RuntimeError("interrupted")
    assert storage.read_json(target) == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["value.json"]


def test_a_full_disk_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no space left"), storage.atomic_file(tmp_path / "x"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), storage.atomic_folder(tmp_path / "out") as partial:
        (partial / "one").write_text("1")
        raise RuntimeError("interrupted")
    assert list(tmp_path.iterdir()) == []
    with storage.atomic_folder(tmp_path / "out") as partial:
        (partial / "one").write_text("1")
    assert (tmp_path / "out" / "one").read_text() == "1"


@pytest.mark.parametrize("left", ["file", "folder"])
def test_what_a_kill_left_is_gone_with_the_next_write(tmp_path: Path, left: str) -> None:
    for name in ("a", "b"):
        partial = tmp_path / f".{name}.partial"  # as the writes below name theirs
        if left == "file":
            partial.write_text("half")
        else:
            (partial / "deeper").mkdir(parents=True)
            (partial / "deeper" / "half").write_text("half")
    storage.write_text(tmp_path / "a", "whole")
    with storage.atomic_folder(tmp_path / "b") as partial:
        assert list(partial.iterdir()) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_an_existing_folder_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match="exists already"), storage.atomic_folder(tmp_path / "out"):
        pass


def test_json_errors_name_the_file(tmp_path: Path) -> None:
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(InputError, match=r"bad\.json"):
        storage.read_json(tmp_path / "bad.json")
    with pytest.raises(InputError, match="is missing"):
        storage.read_json(tmp_path / "none.json")
