from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from recast.core import files
from recast.core.errors import InputError


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "value.json"
    files.write_json(target, {"a": 1})
    with pytest.raises(RuntimeError), files.atomic_file(target) as partial:
        partial.write_text("half")
        raise RuntimeError("interrupted")
    assert files.read_json(target) == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["value.json"]


def test_a_full_disk_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no space left"), files.atomic_file(tmp_path / "x"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), files.atomic_folder(tmp_path / "out") as partial:
        (partial / "one").write_text("1")
        raise RuntimeError("interrupted")
    assert list(tmp_path.iterdir()) == []
    with files.atomic_folder(tmp_path / "out") as partial:
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
    files.write_text(tmp_path / "a", "whole")
    with files.atomic_folder(tmp_path / "b") as partial:
        assert list(partial.iterdir()) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_an_existing_folder_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match="exists already"), files.atomic_folder(tmp_path / "out"):
        pass


def test_json_errors_name_the_file(tmp_path: Path) -> None:
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(InputError, match=r"bad\.json"):
        files.read_json(tmp_path / "bad.json")
    with pytest.raises(InputError, match="is missing"):
        files.read_json(tmp_path / "none.json")


REFUSALS = [
    (errno.ENOSPC, "no space left"),
    (errno.EDQUOT, "no space left"),
    (errno.EROFS, "read-only"),
    (errno.EACCES, "permission denied"),
    (errno.EPERM, "permission denied"),
]


@pytest.mark.parametrize(("code", "said"), REFUSALS)
@pytest.mark.parametrize("call", ["mkdir", "open", "replace", "unlink"])
def test_a_disk_that_refuses_is_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, said: str, call: str
) -> None:
    """Whatever is refused, and where the clean-up is refused as well."""
    target = tmp_path / "deeper" / "value.json"

    def refuse(*args: object, **_: object) -> None:
        raise OSError(code, "refused", str(args[0]))

    for name in {call, "unlink"}:
        monkeypatch.setattr(os, name, refuse)
    if call == "unlink":
        with files.atomic_file(target) as partial:
            partial.write_text("whole")  # nothing needs to be removed
        return
    with pytest.raises(InputError, match=said) as raised, files.atomic_file(target):
        pass
    assert "partial" not in str(raised.value)
    with pytest.raises(InputError, match=said), files.atomic_folder(tmp_path / "deeper" / "out"):
        pass


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000, "nested too deeply"),
        ('{"a":' * 100_000, "nested too deeply"),
        ("1" * 5000, "integer string conversion"),
        ("NaN", "NaN is not a number"),
        ("[-Infinity]", "-Infinity is not a number"),
        ("1e999", "too large"),
        ("", "cannot be read"),
        ("{} {}", "cannot be read"),
    ],
)
def test_hostile_json_is_one_clear_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "bad.json").write_text(text)
    with pytest.raises(InputError, match=said):
        files.read_json(tmp_path / "bad.json")


def test_what_is_no_text_file_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "latin").write_bytes(b'{"a": "\xff"}')
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    faults = {"latin": "utf-8", "loop": "link", ".": "is a folder", "none": "is missing"}
    faults |= {"latin/below": "not a folder", "a\0b": "NUL", "a" * 300: "too long"}
    for name, said in faults.items():
        with pytest.raises(InputError, match=said):
            files.read_json(tmp_path / name)
    with pytest.raises(InputError, match="10 bytes, 9 are read at most"):
        files.read_bytes(tmp_path / "latin", limit=9)
    if Path("/dev/zero").exists():  # says that it has no bytes, and never ends
        with pytest.raises(InputError, match="has 10 bytes, 9 are read at most"):
            files.read_bytes("/dev/zero", limit=9)


def test_two_processes_do_not_write_the_same(tmp_path: Path) -> None:
    """Within one process two handles stand for two processes: flock does not tell them apart."""
    with files.atomic_folder(tmp_path / "out") as partial:
        (partial / "one").write_text("1")
        with (
            pytest.raises(InputError, match="another process is at work"),
            files.atomic_folder(tmp_path / "out"),
        ):
            pass
    assert (tmp_path / "out" / "one").read_text() == "1"
    with files.atomic_file(tmp_path / "file") as partial:
        partial.write_text("first")
        with pytest.raises(InputError, match="at work"), files.atomic_file(tmp_path / "file"):
            pass
    assert (tmp_path / "file").read_text() == "first"


def test_a_lock_ends_with_the_process_that_holds_it(tmp_path: Path) -> None:
    script = (
        "import sys, time; from recast.core import files\n"
        "with files.alone_in(sys.argv[1]):\n"
        "    print('locked', flush=True); time.sleep(60)"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "locked\n"
    with pytest.raises(InputError, match="at work"), files.alone_in(tmp_path):
        pass
    child.kill()
    child.wait()
    with files.alone_in(tmp_path):
        pass


@pytest.mark.parametrize("fault", [errno.EBADF, errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_written_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: int
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(fault, os.strerror(fault))

    monkeypatch.setattr(files.fcntl, "flock", refuse)
    with files.alone_in(tmp_path):
        files.write_text(tmp_path / "a", "written")
    assert (tmp_path / "a").read_text() == "written"
