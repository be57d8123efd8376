"""Commands in child processes that are killed, or refused by the disk, at a chosen moment.

A moment is a change below one folder, see `support.moments.changed`: the n-th is the same in every
run. Where one function is enough instead of a whole command, `support.moments` forks for it.
"""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import resource
import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from recast.core.errors import InputError
from support.moments import REMOVING, Work, changed, forked

KILL = -signal.SIGKILL
_LOADED = (
    "recast.cli.main",
    "recast.runs.bench",
    "recast.runs.run",
    "torch.fx.experimental.symbolic_shapes",  # which training asks for
)
"""What the server that children are forked from imports once."""


@dataclass(frozen=True)
class Fault:
    """What goes wrong with a command.

    Attributes:
        root: changes below this folder are counted.
        kind: `KILL`; or an error number, which every change meets from then on.
        at: number of the change, from 1, or words that its description holds; None for never.
        file_limit: bytes that a file may have at most, which holds for any library; None for all.
    """

    root: Path
    kind: int = KILL
    at: int | str | None = None
    file_limit: int | None = None


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes:
        code: exit code; `KILL` if it was killed.
        moments: descriptions of all changes, such as "os.rename run/run.json".
        err: what it wrote to standard error.
    """

    code: int
    moments: tuple[str, ...]
    err: str


def command(args: Sequence[str | Path], fault: Fault, notes: Path) -> Ended:
    """Run `recast` with `args` in a child.

    Args:
        notes: new folder, elsewhere, for what the child says.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(_LOADED))
    notes.mkdir(parents=True)
    child = context.Process(target=_child, args=([str(arg) for arg in args], fault, notes))
    child.start()
    child.join()
    moments = (notes / "moments").read_text().splitlines()
    assert child.exitcode is not None
    return Ended(child.exitcode, tuple(json.loads(m) for m in moments), (notes / "err").read_text())


def refused_from(change: int, kind: int, work: Work, folder: Path) -> bool:
    """Run `work` in a copy of this process: the disk refuses from a change of `folder` on.

    Args:
        change: number of the first change that meets it, from 1.
        kind: error number.

    Returns:
        Whether it came to that, and ended in one line.
    """

    def watched() -> None:
        _Watch(Fault(folder, kind, change), os.open(os.devnull, os.O_WRONLY)).begin()
        try:
            work()
        except InputError as error:
            os._exit(2 if len(str(error).splitlines()) == 1 else 1)

    code = os.waitstatus_to_exitcode(os.waitpid(forked(watched), 0)[1])
    assert code in (0, 2)
    return code == 2


def _child(args: list[str], fault: Fault, notes: Path) -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    os.dup2(os.open(notes / "err", os.O_WRONLY | os.O_CREAT), sys.stderr.fileno())
    import torch

    import recast.runs.actor as actor
    from recast.actors.refine import Steps, refine
    from recast.cli.main import main

    torch.set_num_threads(1)
    actor._TURNTABLE_VIEWS, actor._TURNTABLE_SIZE = 2, (32, 32)  # type: ignore[misc]
    actor.refine = partial(refine, steps=Steps(shape=4, paint=2, free=4, look_every=2))  # type: ignore[assignment]
    if fault.file_limit is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (fault.file_limit, resource.RLIM_INFINITY))
    _Watch(fault, os.open(notes / "moments", os.O_WRONLY | os.O_CREAT)).begin()
    code = main(args)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


class _Watch:
    def __init__(self, fault: Fault, notes: int) -> None:
        self.fault, self.notes = fault, notes
        self.seen, self.broken = 0, False

    def begin(self) -> None:
        sys.addaudithook(self.look)

    def look(self, event: str, args: tuple[Any, ...]) -> None:
        path = changed(event, args, self.fault.root)
        if path is None:
            return
        self.seen += 1
        moment = f"{event} {os.path.relpath(path, self.fault.root)}"
        at = self.fault.at
        reached = at == self.seen if isinstance(at, int) else at is not None and at in moment
        self.broken = self.broken or reached
        if self.fault.file_limit is None:
            os.write(self.notes, json.dumps(moment).encode() + b"\n")
        if not self.broken:
            return
        if self.fault.kind == KILL:
            os.kill(os.getpid(), signal.SIGKILL)
        if event in REMOVING and self.fault.kind != errno.EROFS:
            return  # a full disk lets go of files
        raise OSError(self.fault.kind, os.strerror(self.fault.kind), path)
