"""One process that reads damaged files, within limits of time and memory.

It is given jobs as JSON lines, and answers with one line for every input; where it dies, the input
that it had announced last is the one that killed it.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import sys
import tempfile
import traceback
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from fuzz.check import first_fault
from fuzz.mutators import mutate
from fuzz.target import Target, all_targets
from recast.core.errors import LINE_LIMIT, InputError

SECONDS = 20
"""Processor time of one input; the slowest sample takes less than a tenth of it."""

ADDRESSES = 3 << 30
"""Bytes of address space beyond what the interpreter and the libraries take at the start."""

RESIDENT = 1 << 30
"""Bytes of memory that one input may take; samples have less than a megabyte."""


class Bench:
    """Samples of targets, damaged one file at a time."""

    def __init__(self, root: Path) -> None:
        self._root = root
        root.mkdir(exist_ok=True)
        self._targets = all_targets()

    def prepare(self, name: str) -> tuple[Target, Path]:
        """The target and its sample, which its reader accepts."""
        target, folder = self._targets[name], self._root / name / "sample"
        if not folder.exists():
            folder.mkdir(parents=True)
            target.write(folder)
            outcome, text = self._judge(target, folder)
            assert outcome == "accepted", f"{name}: the sample itself: {outcome}: {text}"
        return target, folder

    def damage(self, name: str, seed: int, number: int) -> tuple[str, bytes]:
        """The file and its damaged bytes of one input; the same on every machine."""
        target, folder = self.prepare(name)
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), number])
        members = target.members(folder)
        member = members[int(rng.integers(len(members)))]
        return member, mutate(member, (folder / member).read_bytes(), rng)

    def read(self, name: str, files: dict[str, bytes]) -> tuple[str, str]:
        """Outcome and text of reading the sample with these files in place of its own."""
        target, folder = self.prepare(name)
        before = {member: (folder / member).read_bytes() for member in files}
        try:
            for member, data in files.items():
                (folder / member).write_bytes(data)
            return self._judge(target, folder)
        finally:
            for member, data in before.items():
                (folder / member).write_bytes(data)

    def _judge(self, target: Target, folder: Path) -> tuple[str, str]:
        out = folder.parent / "out" / "result"
        beside = sorted(self._root.iterdir()), sorted(folder.parent.iterdir())
        out.parent.mkdir(exist_ok=True)
        _limit_time()
        memory, peak = _resident(), _peak()
        try:
            value = target.read(folder, out)
        except InputError as error:
            line = str(error)
            if len(line) > LINE_LIMIT or len(line.splitlines()) != 1:
                return "fault", f"is not one line: {line!r}"
            if any(out.parent.iterdir()) and not target.resumes:
                left = ", ".join(path.name for path in out.parent.iterdir())
                return "fault", f"left {left} behind after: {line}"
            return "clean", line
        except BaseException:
            return "fault", traceback.format_exc(limit=-6)
        finally:
            shutil.rmtree(out.parent)
        if beside != (sorted(self._root.iterdir()), sorted(folder.parent.iterdir())):
            return "fault", "wrote outside of its output folder"
        wrong = first_fault(value)
        if wrong is not None:
            return "fault", f"accepted, and {wrong} is not finite"
        if _peak() > max(peak, memory + RESIDENT):
            return "fault", f"took {(_peak() - memory) >> 20} MiB of memory"
        return "accepted", ""


def _resident() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _limit_time() -> None:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    used = int(usage.ru_utime + usage.ru_stime)
    resource.setrlimit(resource.RLIMIT_CPU, (used + SECONDS, resource.RLIM_INFINITY))


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * os.sysconf("SC_PAGE_SIZE") + ADDRESSES
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))


def main() -> None:
    """Answer jobs until the input ends."""
    import torch

    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what a library prints is no answer

    def answer(**values: Any) -> None:
        answers.write(json.dumps(values) + "\n")

    with tempfile.TemporaryDirectory(prefix="recast-fuzz-") as folder:
        root = Path(folder)
        (root / "temporary").mkdir()
        os.environ["TMPDIR"] = tempfile.tempdir = str(root / "temporary")
        bench = Bench(root / "samples")
        _limit_memory()
        for line in sys.stdin:
            job = json.loads(line)
            name = job["target"]
            if "files" in job:
                files = {key: Path(path).read_bytes() for key, path in job["files"].items()}
                answer(at=0)
                outcome, text = bench.read(name, files)
                answer(number=0, outcome=outcome, text=text)
                continue
            bench.prepare(name)
            for number in range(job["first"], job["first"] + job["count"]):
                answer(at=number)
                member, data = bench.damage(name, job["seed"], number)
                outcome, text = bench.read(name, {member: data})
                answer(number=number, outcome=outcome, text=text)


if __name__ == "__main__":
    main()
