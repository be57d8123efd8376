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

from recast.errors import InputError

Work = Callable[[], object]
_CHANGES = {"os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate", "os.link"}
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


def _before_changes(folder: Path, hook: Work) -> None:
    prefix = str(folder)

    def on_event(event: str, args: tuple[object, ...]) -> None:
        if event == "open":
            path, _, flags = args
            if not isinstance(flags, int) or not flags & _WRITING:
                return
        elif event in _CHANGES:
            path = args[0]
        else:
            return
        if isinstance(path, str | bytes | os.PathLike) and os.fsdecode(path).startswith(prefix):
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
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
