"""Where the time of a grid went; kept apart from its results, which are the same every time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from recast import storage
from recast.pipeline.bench.settings import SCENES_FOLDER, TIMES_FILE, BenchSettings
from recast.pipeline.bench.tasks import RolloutTask, RolloutTimes
from recast.pipeline.bench.worker import RUN_FOLDER

PARTS = ("render", "plan", "control", "rest")
_SCENE_STEPS = ("actor", "scene", "evaluation")


class Times:
    """times.json: seconds of every rollout, of every scene's preparation, and of every session.

    Args:
        out: folder of the grid; what earlier sessions took is kept.
        workers: of this session.
    """

    def __init__(self, out: Path, workers: int) -> None:
        self._path = out / TIMES_FILE
        before = storage.read_json(self._path) if self._path.is_file() else {}
        self._rollouts: dict[str, dict[str, float]] = before.get("rollouts", {})
        self._sessions: list[dict[str, float]] = before.get("sessions", [])
        self._session: dict[str, float] = {"workers": workers, "seconds": 0.0, "rollouts": 0}

    def note(self, task: RolloutTask, times: RolloutTimes, seconds: float) -> None:
        """A rollout was made, `seconds` after the session began."""
        self._rollouts[task.key] = {k: round(v, 4) for k, v in asdict(times).items()}
        self._session["rollouts"] += 1
        self.write(seconds)

    def write(self, seconds: float, settings: BenchSettings | None = None) -> dict[str, Any]:
        """Write the file, with sums where the grid is finished; return its content."""
        self._session["seconds"] = round(seconds, 2)
        value: dict[str, Any] = {"version": 1, "sessions": [*self._sessions, self._session]}
        if settings is not None:
            value |= self._sums(settings)
        value["rollouts"] = dict(sorted(self._rollouts.items()))
        storage.write_json(self._path, value)
        return value

    def _sums(self, settings: BenchSettings) -> dict[str, Any]:
        by_method = {
            method: _sum(v for k, v in self._rollouts.items() if k.endswith(f"/{method}"))
            for method in settings.run.methods
        }
        scenes = {}
        for scene in settings.scenes:
            path = self._path.parent / SCENES_FOLDER / scene.id / RUN_FOLDER / "timings.json"
            found: Mapping[str, float] = storage.read_json(path) if path.is_file() else {}
            scenes[scene.id] = {name: found[name] for name in _SCENE_STEPS if name in found}
        return {"all": _sum(self._rollouts.values()), "methods": by_method, "scenes": scenes}


def _sum(rollouts: Iterable[Mapping[str, float]]) -> dict[str, Any]:
    """Seconds by part, their shares of the whole, and how many rollouts they are of."""
    rows: Sequence[Mapping[str, float]] = list(rollouts)
    total = sum(row["total"] for row in rows)
    seconds = {name: sum(row[name] for row in rows) for name in PARTS if name != "rest"}
    seconds["rest"] = total - sum(seconds.values())
    return {
        "rollouts": len(rows),
        "seconds": round(total, 2),
        "frames": sum(row["frames"] for row in rows),
        "parts": {name: round(seconds[name], 2) for name in PARTS},
        "shares": {name: round(seconds[name] / total, 4) if total else None for name in PARTS},
    }
