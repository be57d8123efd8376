"""Where the time of a grid went; kept apart from its results, which are the same every time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, NonNegativeFloat, NonNegativeInt

from recast import storage
from recast.pipeline.bench.settings import TIMES_FILE, BenchSettings
from recast.pipeline.bench.tasks import RolloutTask, RolloutTimes
from recast.pipeline.layout import use_parts
from recast.records import read_record

PARTS = ("render", "plan", "control", "rest")
TIMES_VERSION: Literal[2] = 2


class _Session(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    workers: NonNegativeInt
    seconds: NonNegativeFloat = 0.0
    rollouts: NonNegativeInt = 0


class _Earlier(BaseModel):
    """What is kept of an earlier times.json; the sums are made anew."""

    model_config = ConfigDict(allow_inf_nan=False)

    rollouts: dict[str, RolloutTimes] = {}
    sessions: list[_Session] = []


class Times:
    """times.json: seconds of every rollout, of every scene's preparation, and of every session.

    Args:
        out: folder of the grid; what earlier sessions took is kept.
        workers: of this session.

    Raises:
        InputError: the file of the earlier sessions is damaged.
    """

    def __init__(self, out: Path, workers: int) -> None:
        self._path, before = out / TIMES_FILE, _Earlier()
        if self._path.is_file():
            before = read_record(self._path, _Earlier, TIMES_VERSION, "remove it")
        self._rollouts, self._sessions = before.rollouts, before.sessions
        self._session = _Session(workers=workers)

    def note(self, task: RolloutTask, times: RolloutTimes, seconds: float) -> None:
        """A rollout was made, `seconds` after the session began."""
        self._rollouts[f"{task.scene.id}/{task.use}"] = times
        self._session.rollouts += 1
        self.write(seconds)

    def write(
        self,
        seconds: float,
        settings: BenchSettings | None = None,
        scenes: Mapping[str, Mapping[str, float]] | None = None,
    ) -> dict[str, Any]:
        """Write the file, with sums where the grid is finished; return its content.

        Args:
            scenes: by scene, the seconds that its artefacts took.
        """
        self._session.seconds = round(seconds, 2)
        sessions = [session.model_dump() for session in (*self._sessions, self._session)]
        value: dict[str, Any] = {"version": TIMES_VERSION, "sessions": sessions}
        if settings is not None:
            value |= {**self._sums(settings), "scenes": scenes or {}}
        value["rollouts"] = {
            key: {name: round(one, 4) for name, one in vars(times).items()}
            for key, times in sorted(self._rollouts.items())
        }
        storage.write_json(self._path, value)
        return value

    def _sums(self, settings: BenchSettings) -> dict[str, Any]:
        by_arm = {
            arm.name: _sum(v for k, v in self._rollouts.items() if use_parts(k)[-1] == arm.name)
            for arm in settings.run.arms
        }
        return {"all": _sum(self._rollouts.values()), "arms": by_arm}


def _sum(rollouts: Iterable[RolloutTimes]) -> dict[str, Any]:
    """Seconds by part, their shares of the whole, and how many rollouts they are of."""
    rows: Sequence[RolloutTimes] = list(rollouts)
    total = sum(row.total for row in rows)
    seconds = {name: sum(getattr(row, name) for row in rows) for name in PARTS if name != "rest"}
    seconds["rest"] = total - sum(seconds.values())
    return {
        "rollouts": len(rows),
        "seconds": round(total, 2),
        "frames": sum(row.frames for row in rows),
        "parts": {name: round(seconds[name], 2) for name in PARTS},
        "shares": {name: round(seconds[name] / total, 4) if total else None for name in PARTS},
    }
