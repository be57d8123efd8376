"""Kills and refusals at chosen moments of a run: every change of a folder is an audit event.

Python raises these events just before it opens, makes, renames or removes a file. `work` always
runs in a forked copy of the test process, since audit hooks cannot be taken back.
"""

from __future__ import annotations

import errno
import os
import resource
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from recast.core.errors import InputError

Work = Callable[[], object]
REMOVING = ("os.remove", "os.rmdir")
_CHANGES = ("os.mkdir", "os.rename", "os.truncate", "os.link", "os.symlink", *REMOVING)
_TWO_PATHS = ("os.rename", "os.link", "os.symlink")
"""The second is the one that comes into being."""
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC


def changes_of(work: Work, folder: Path) -> int:
    """How many times `work` changes something at or below `folder`."""
    count = 0

    def hook() -> None:
        nonlocal count
        count += 1

    receiving, sending = os.pipe()

    def counted() -> None:
        _before_changes(folder, hook)
        work()
        os.write(sending, str(count).encode())

    assert _ended(counted) == 0
    os.close(sending)
    with os.fdopen(receiving, "rb") as stream:
        return int(stream.read())


def killed_before(change: int, work: Work, folder: Path) -> bool:
    """Run `work`, killed (SIGKILL) before change number `change`, from 0; whether it came to it."""
    left = change

    def hook() -> None:
        nonlocal left
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        left -= 1

    def doomed() -> None:
        _before_changes(folder, hook)
        work()

    return _ended(doomed) == -signal.SIGKILL


def said_on_a_read_only_disk(work: Work, folder: Path) -> str:
    """The `InputError` with which `work` ends where `folder` cannot be changed."""

    def hook() -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(folder))

    def refused() -> None:
        _before_changes(folder, hook)
        work()

    return _said(refused)


def said_on_a_full_disk(work: Work, size: int = 0) -> str:
    """The `InputError` with which `work` ends where no file may grow beyond `size` bytes."""

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
        work()

    return _said(limited)


def changed(event: str, args: tuple[Any, ...], folder: Path) -> str | None:
    """The path at or below `folder` that an audit event is about to change, or None."""
    if event == "open":
        path, _, flags = args
        wanted = isinstance(flags, int) and flags & _WRITING
    elif event in _CHANGES:
        path, wanted = args[event in _TWO_PATHS], True
    else:
        return None
    if not wanted or not isinstance(path, str | bytes | os.PathLike):
        return None
    path, within = os.fsdecode(path), args[-1]
    if event in REMOVING and isinstance(within, int) and within >= 0:  # as `shutil.rmtree` does
        try:
            path = os.path.join(Path(f"/proc/self/fd/{within}").readlink(), path)  # noqa: PTH118
        except OSError:  # not on Linux: what is removed there is no moment
            return None
    path = os.path.abspath(path)  # noqa: PTH100
    return path if path == str(folder) or path.startswith(f"{folder}{os.sep}") else None


def _before_changes(folder: Path, hook: Work) -> None:
    def on_event(event: str, args: tuple[Any, ...]) -> None:
        if changed(event, args, folder) is not None:
            hook()

    sys.addaudithook(on_event)


def _said(work: Work) -> str:
    """Message of the `InputError` that `work` raises in a child; any other end fails the test."""
    receiving, sending = os.pipe()

    def told() -> None:
        try:
            work()
        except InputError as error:
            os.write(sending, str(error).encode())

    code = _ended(told)
    os.close(sending)
    with os.fdopen(receiving, "rb") as stream:
        said = stream.read().decode()
    assert code == 0 and said, "ended otherwise than by an InputError"
    return said


def _ended(work: Work) -> int:
    """Run in a forked copy of this process; its exit code, or minus the signal that ended it."""
    return os.waitstatus_to_exitcode(os.waitpid(forked(work), 0)[1])


def forked(work: Work) -> int:
    """Start `work` in a copy of this process, which ends with it; its number."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            work()
            code = 0
        except BaseException:
            sys.excepthook(*sys.exc_info())
        finally:
            sys.stderr.flush()
            os._exit(code)
    return child
