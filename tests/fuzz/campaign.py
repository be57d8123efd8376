"""Runs many inputs in child processes, counts what becomes of them, keeps every fault.

    python -m fuzz.campaign --inputs 100000 --workers 2      (what `make fuzz` does)

The same command goes on where the last one stopped: what is done lies in `--state`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from threading import Lock
from typing import Any, Self

from fuzz.target import all_targets

TESTS = Path(__file__).parents[1]
REGRESSIONS = Path(__file__).parent / "regressions"
"""TARGET/HASH/ holds the damaged files of one fault, under their names in the sample."""

BLOCK = 200
"""Inputs of one job at most."""


@dataclass(frozen=True)
class Result:
    """What became of an input: "clean" (refused in one line), "accepted" or "fault"."""

    number: int
    outcome: str
    text: str


class Child:
    """A process that reads damaged files; a new one where it died."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115

    def __enter__(self) -> Self:
        """The child starts with its first job."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self._end()
        self._errors.close()

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _start(self) -> subprocess.Popen[str]:
        paths = os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])
        environment = {**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1"}
        # One arena: glibc would reserve 64 MiB of addresses for every thread of a library.
        environment |= {"MALLOC_ARENA_MAX": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}
        return subprocess.Popen(
            [sys.executable, "-m", "fuzz.child"],
            env=environment,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
        )

    def _ask(self, job: Mapping[str, Any], count: int) -> Iterator[Result]:
        if self._process is None or self._process.poll() is not None:
            self._process = self._start()
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(json.dumps(job) + "\n")
        process.stdin.flush()
        at, done = None, 0
        while done < count:
            line = process.stdout.readline()
            if not line:
                code = process.wait()
                self._process = None
                if at is None:  # not of an input, but of the target itself
                    self._errors.seek(0)
                    raise RuntimeError(f"{job['target']}: {self._errors.read()[-3000:]}")
                yield Result(
                    at, "fault", f"the process ended with {code} (time, memory or a crash)"
                )
                return
            answer = json.loads(line)
            if "at" in answer:
                at = answer["at"]
            else:
                done += 1
                yield Result(answer["number"], answer["outcome"], answer["text"])

    def run(self, target: str, first: int, count: int, seed: int = 0) -> Iterator[Result]:
        """Inputs `first` to `first + count` of a target, made from `seed`."""
        end = first + count
        while first < end:
            job = {"target": target, "first": first, "count": end - first, "seed": seed}
            for result in self._ask(job, end - first):
                yield result
                first = result.number + 1

    def replay(self, target: str, folder: Path) -> Result:
        """The fault that lies in a folder of `REGRESSIONS`."""
        files = {p.relative_to(folder).as_posix(): str(p) for p in folder.rglob("*") if p.is_file()}
        (result,) = self._ask({"target": target, "files": files}, 1)
        return result


def shares(inputs: int) -> dict[str, int]:
    """Inputs of each target, at least `inputs` in all."""
    targets = all_targets()
    total = sum(target.weight for target in targets.values())
    return {name: ceil(inputs * target.weight / total) for name, target in targets.items()}


def keep(name: str, seed: int, result: Result) -> Path:
    """Write the damaged file of a fault below `REGRESSIONS`."""
    from fuzz.child import Bench

    with tempfile.TemporaryDirectory() as folder:
        member, data = Bench(Path(folder) / "samples").damage(name, seed, result.number)
    place = REGRESSIONS / name / hashlib.sha256(data).hexdigest()[:12]
    path = place / member
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return place


def campaign(inputs: int, workers: int, seed: int, state: Path) -> Counter[tuple[str, str]]:
    """Run what is missing of `inputs`; return counts by target and outcome."""
    done: dict[str, int] = {}
    counts: Counter[tuple[str, str]] = Counter()
    seconds: dict[str, float] = {}
    if state.is_file():
        before = json.loads(state.read_text())
        if before["seed"] == seed:
            done, seconds = before["done"], before["seconds"]
            counts.update({tuple(key.split(" ")): n for key, n in before["counts"].items()})  # type: ignore[misc]
    jobs = [
        (name, first, min(BLOCK, wanted - first))
        for name, wanted in shares(inputs).items()
        for first in range(done.get(name, 0), wanted, BLOCK)
    ]
    jobs.sort(key=lambda job: job[1])  # all targets get on alike
    lock, queue = Lock(), iter(jobs)
    finished: dict[tuple[str, int], tuple[Counter[tuple[str, str]], float]] = {}

    def note(name: str, first: int, found: Counter[tuple[str, str]], spent: float) -> None:
        finished[name, first] = found, spent
        # Only what has no gap before it is written: a campaign that goes on begins at `done`.
        while (name, done.get(name, 0)) in finished:
            found, spent = finished.pop((name, done.get(name, 0)))
            done[name] = done.get(name, 0) + found.total()
            seconds[name] = seconds.get(name, 0.0) + spent
            counts.update(found)
        record = {"seed": seed, "done": done, "seconds": seconds}
        record["counts"] = {" ".join(key): n for key, n in counts.items()}
        state.parent.mkdir(parents=True, exist_ok=True)
        partial = state.with_suffix(".partial")
        partial.write_text(json.dumps(record, indent=1))
        partial.replace(state)

    def work(_: int) -> None:
        with Child() as child:
            while True:
                with lock:
                    job = next(queue, None)
                if job is None:
                    return
                name, first, count = job
                began, found = time.monotonic(), Counter[tuple[str, str]]()
                for result in child.run(name, first, count, seed):
                    found[name, result.outcome] += 1
                    if result.outcome == "fault":
                        place = keep(name, seed, result)
                        print(f"FAULT {name} {result.number} {place}\n{result.text}", flush=True)
                with lock:
                    note(name, first, found, time.monotonic() - began)

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, range(workers)))
    return counts


def table(counts: Counter[tuple[str, str]]) -> str:
    """Counts as a table of docs/reliability.md."""
    rows = [
        "| reader | inputs | refused in one line | accepted and valid | faults |",
        "|---|" + "--:|" * 4,
    ]
    names = sorted({name for name, _ in counts})
    for name in [*names, "all"]:
        found = [
            sum(
                n
                for (target, kind), n in counts.items()
                if kind == outcome and name in (target, "all")
            )
            for outcome in ("clean", "accepted", "fault")
        ]
        rows.append(f"| {name} | {sum(found)} | " + " | ".join(str(n) for n in found) + " |")
    return "\n".join(rows)


def main() -> int:
    """Run a campaign; 1 where there was a fault."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1, help="seed 0 is that of `make test`")
    parser.add_argument("--state", type=Path, default=Path("build/fuzz/state.json"))
    options = parser.parse_args()
    began = time.monotonic()
    counts = campaign(options.inputs, options.workers, options.seed, options.state)
    print(table(counts))
    print(f"{sum(counts.values())} inputs, {time.monotonic() - began:.0f} s in this session")
    return int(any(outcome == "fault" for _, outcome in counts))


if __name__ == "__main__":
    sys.exit(main())
