"""What a training writes down: means over some steps, as lines of JSON."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from recast.errors import InputError
from recast.records import validation_error
from recast.storage import disk_errors, parse_json, read_text, write_text

LOG_FILE = "log.jsonl"
_LINE: TypeAdapter[dict[str, int | float]] = TypeAdapter(dict[str, int | float])


@dataclass
class Means:
    """Sums and counts by name of the values that were finite.

    A checkpoint keeps them, so that the lines of a resumed log are those of an uninterrupted one.
    """

    sums: dict[str, float] = field(default_factory=dict)
    counts: dict[str, float] = field(default_factory=dict)

    def add(self, values: Mapping[str, float]) -> None:
        """Count values in; one that is not finite only makes its name known."""
        for name, value in values.items():
            known = math.isfinite(value)
            self.sums[name] = self.sums.get(name, 0.0) + (value if known else 0.0)
            self.counts[name] = self.counts.get(name, 0.0) + known

    def means(self) -> dict[str, float]:
        """By name; NaN where nothing finite was seen."""
        return {
            name: total / self.counts[name] if self.counts[name] else math.nan
            for name, total in self.sums.items()
        }


class TrainingLog:
    """Appends to a `log.jsonl`.

    Args:
        path: of the file; lines of steps after `step`, which a kill undid, are dropped.
        step: done so far.
        every: steps from line to line.
        pending: means since the last line.
    """

    def __init__(self, path: Path, step: int, every: int, pending: Means) -> None:
        self.path, self.every, self.pending = path, every, pending
        self._since = time.perf_counter()
        kept = [line for line in read_log_lines(path) if line["step"] <= step]
        write_text(path, "".join(f"{json.dumps(line)}\n" for line in kept))

    def due(self, step: int) -> bool:
        """Whether a line ends with this step."""
        return step % self.every == 0

    def write(self, step: int, extra: Mapping[str, float]) -> dict[str, float]:
        """Write the line of a step, with further values; gives back what it says.

        `seconds` are those since the last line, or since the training was resumed.
        """
        values = {**self.pending.means(), **extra}
        values = {name: value for name, value in values.items() if math.isfinite(value)}
        seconds = round(time.perf_counter() - self._since, 3)
        with disk_errors(self.path), self.path.open("a") as stream:
            stream.write(json.dumps({"step": step, "seconds": seconds, **values}) + "\n")
        self.pending.sums.clear()
        self.pending.counts.clear()
        self._since = time.perf_counter()
        return values


def read_log_lines(path: Path) -> list[dict[str, float]]:
    """The lines of a log, but for a last one that a kill cut short; none where there is no log.

    Raises:
        InputError: another line cannot be read, or is no line of a log.
    """
    whole = read_text(path).split("\n")[:-1] if path.exists() else []
    return [_line(f"{path}: line {number}", text) for number, text in enumerate(whole, 1)]


def _line(where: str, text: str) -> dict[str, float]:
    mend = "remove the line"
    try:
        values = _LINE.validate_python(parse_json(where, text))
    except ValidationError as error:
        raise validation_error(where, error, mend) from None
    if not {"step", "seconds"} <= values.keys():
        raise InputError(where, "line", "lacks step or seconds", mend)
    return values
