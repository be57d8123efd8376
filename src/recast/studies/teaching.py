"""Training in the loop: what a planner comes to see, and what an expert would do there.

A recording shows only states that a good driver came to. Rollouts of the present planner show its
own, and an expert that knows more than the images labels them (DAgger, Ross et al. 2011).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recast.arrays import Array, Image
from recast.core.diagnostics import Progress
from recast.core.errors import InputError, require_range
from recast.core.files import (
    alone_in,
    atomic_folder,
    disk_errors,
    read_bytes,
    write_bytes,
    write_json,
)
from recast.core.foreign import whole
from recast.core.records import Record, read_record
from recast.core.table_files import read_parquet, write_parquet
from recast.logs.images import decode, encode, size_of
from recast.planning import BasePlanner, Plan, Planner, PlannerInput, make_planner
from recast.planning.types import ACTOR_COLUMNS, WAYPOINTS, ego_status
from recast.simulation import Simulator
from recast.simulation.planner_calls import PlannerCalls
from recast.simulation.recorded_drive import what_is_ahead

SAMPLES_FILE, RECORD_FILE = "samples.parquet", "rollout.json"
_FLOATS = pa.list_(pa.float32())
_SCHEMA = pa.schema(
    {
        "timestamp_us": pa.int64(),
        "driver": pa.string(),
        "ahead": pa.string(),
        "status": _FLOATS,
        "planner": _FLOATS,
        "expert": _FLOATS,
        "boxes": _FLOATS,
        "images": pa.string(),
    }
)
_MEND = "collect the samples again, into another folder"
_LARGEST = 1 << 28
"""Bytes of an image's file, at most."""

Episode = Callable[[], Simulator]
"""Makes one rollout, ready to begin."""


class Learner(Planner, Protocol):
    """A planner that can be trained: the whole seam is one more method."""

    def learn(self, samples: Sequence[Path]) -> None:
        """Train on folders of `collect_samples`, the newest last, and plan accordingly.

        See `read_samples` for what is in them.
        """


class CollectedRollout(Record):
    """`rollout.json`: what became of an episode.

    Attributes:
        driver: who drove.
        moments: number of samples.
        unlabelled: number of moments at which the expert failed, which are left out.
        failed: why the rollout ended early or could not be made; "" if it did not.
    """

    format: Literal["recast-driving-samples"] = "recast-driving-samples"
    version: Literal[1] = 1
    driver: Literal["planner", "expert"]
    moments: int = 0
    unlabelled: int = 0
    failed: str = ""


def collect_samples(
    planner: Planner,
    episodes: Sequence[Episode],
    out: str | Path,
    *,
    expert: str | Planner = "expert",
    expert_drives: float = 0.0,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[CollectedRollout]:
    """Let a planner drive, and write each moment with what an expert would do there.

    `out` gets a folder for each episode, whole or not at all: `samples.parquet`, a row for each
    plan, `rollout.json`, and the images as PNG files. The same call goes on where it was killed.

    Args:
        episodes: rollouts; their arms, logs and motions are what the samples show. They are made
            one after the other.
        expert: who labels: a planner that reads boxes and map, or its name. It is told where the
            others will be if it `foresees`, as the default one does.
        expert_drives: share of the episodes that the expert drives, such as 1 as long as the
            planner knows nothing.
        seed: seed of who drives which episode, and of the rollouts.

    Returns:
        What became of each episode. One that cannot be made, a planner that fails and an expert
        that fails cost their samples alone.

    Raises:
        InputError: a share beyond 0 to 1, or another process is at work in `out`.
    """
    if not 0.0 <= expert_drives <= 1.0:
        problem, mend = f"is {expert_drives:g}", "give a share from 0 to 1"
        raise InputError("collect_samples", "expert_drives", problem, mend)
    out, teacher = Path(out), make_planner(expert)
    rng = np.random.default_rng(seed)
    drivers = rng.permutation(len(episodes)) < round(expert_drives * len(episodes))
    found = []
    with disk_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    with alone_in(out):
        for index, episode in enumerate(episodes):
            folder = out / f"rollout-{index:05d}"
            if not folder.exists():
                one = _Collector(whole(planner, BasePlanner), teacher, bool(drivers[index]))
                one.drive(episode, seed + index, folder)
            found.append(_record(folder))
            if progress is not None:
                progress(index + 1, len(episodes))
    return found


class _Collector:
    """One episode, as it is driven."""

    def __init__(self, planner: BasePlanner, expert: BasePlanner, expert_drives: bool) -> None:
        self.planner, self.expert = planner, expert
        self.driver: Literal["planner", "expert"] = "expert" if expert_drives else "planner"
        self.rows: list[dict[str, object]] = []
        self.unlabelled = 0

    def drive(self, episode: Episode, seed: int, folder: Path) -> None:
        failed = ""
        with atomic_folder(folder) as partial:
            # A user's planner and a world may fail in any way; the other episodes go on.
            try:
                self._rollout(episode(), seed, partial)
            except Exception as error:
                failed = " ".join(str(error).split()) or type(error).__name__
            write_parquet(partial / SAMPLES_FILE, pa.Table.from_pylist(self.rows, schema=_SCHEMA))
            record = CollectedRollout(
                driver=self.driver,
                moments=len(self.rows),
                unlabelled=self.unlabelled,
                failed=failed,
            )
            write_json(partial / RECORD_FILE, record.model_dump(mode="json"))

    def _rollout(self, simulator: Simulator, seed: int, folder: Path) -> None:
        seen = simulator.reset(seed=seed)
        planner, expert = PlannerCalls(self.planner), PlannerCalls(self.expert)
        for one in (planner, expert):
            one.reset(simulator.context)
        try:
            while not simulator.done:
                seen = simulator.step(self._moment(simulator, seen, planner, expert, folder))
        finally:
            planner.finish()
            expert.finish()

    def _moment(
        self,
        simulator: Simulator,
        seen: PlannerInput,
        planner: PlannerCalls,
        expert: PlannerCalls,
        folder: Path,
    ) -> Plan:
        plan = planner.timed_plan(seen, None)[0]
        try:
            told = seen
            if self.expert.foresees:
                told = simulator.observe(seen.images, foretold=True)
            label = expert.timed_plan(told, None)[0]
        except Exception:
            self.unlabelled += 1
            return plan
        names = {name: f"{seen.step:04d}-{name}.png" for name in seen.images}
        for name, file in names.items():
            write_bytes(folder / file, encode(seen.images[name]))
        self.rows.append(
            {
                "timestamp_us": seen.timestamp_us,
                "driver": self.driver,
                "ahead": what_is_ahead(seen, simulator.context.route),
                "status": ego_status(seen.command, seen.ego),
                "planner": plan.waypoints.ravel(),
                "expert": label.waypoints.ravel(),
                "boxes": np.ravel([one.seen_from(seen.ego.pose) for one in seen.actors]),
                "images": " ".join(names.values()),
            }
        )
        return label if self.driver == "expert" else plan


def _record(folder: Path) -> CollectedRollout:
    name = folder / RECORD_FILE
    return read_record(name, CollectedRollout, 1, _MEND, "recast-driving-samples")


@dataclass(frozen=True)
class DrivingSamples:
    """Samples in memory, but for their images.

    Attributes:
        status: (N, 8) float32, see `ego_status`.
        planner, expert: (N, 40, 3) waypoints of both, as in `Plan`.
        ahead: (N,) what is ahead, see `recast.simulation.recorded_drive.what_is_ahead`.
        boxes: (n, 8) road users of each, see `recast.planning.types.ACTOR_COLUMNS`.
        files: image files of each by camera.
    """

    status: NDArray[np.float32]
    planner: Array
    expert: Array
    ahead: NDArray[np.object_]
    boxes: tuple[Array, ...]
    files: tuple[Mapping[str, Path], ...]

    def __len__(self) -> int:
        return len(self.ahead)

    @property
    def balanced(self) -> Array:
        """(N,) probabilities by which each kind of what is ahead is drawn equally often."""
        counts = Counter(self.ahead.tolist())
        return np.array([1.0 / (counts[kind] * len(counts)) for kind in self.ahead])

    def images(self, index: int) -> dict[str, Image]:
        """(H, W, 3) uint8 by camera. Raises InputError: a file is missing or broken."""
        found = {}
        for name, path in self.files[index].items():
            data = read_bytes(path, _LARGEST)
            size = size_of(data, "png", path)
            found[name] = decode(data, "png", size, path, SAMPLES_FILE)
        return found


def read_samples(folders: Sequence[str | Path]) -> DrivingSamples:
    """All samples of folders that `collect_samples` wrote.

    Raises:
        InputError: there are none, or a file is missing or damaged.
    """
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("status", "planner", "expert")}
    ahead: list[str] = []
    boxes: list[Array] = []
    files: list[Mapping[str, Path]] = []
    widths = {"status": 8, "planner": 3 * WAYPOINTS, "expert": 3 * WAYPOINTS}
    for path in sorted(path for one in folders for path in Path(one).glob("rollout-*")):
        if not _record(path).moments:
            continue
        table = read_parquet(path / SAMPLES_FILE, _SCHEMA.names, _MEND)
        for name, values in rows.items():
            values.append(table.lists(name, widths[name]))
        ahead += table.words("ahead").tolist()
        for row, cell in enumerate(table.data.column("boxes").to_pylist()):
            if cell is None or len(cell) % len(ACTOR_COLUMNS) or None in cell:
                problem = f"is not {len(ACTOR_COLUMNS)} numbers for each road user"
                raise InputError(path / SAMPLES_FILE, f"column boxes, row {row}", problem, _MEND)
            boxes.append(np.reshape(cell, (-1, len(ACTOR_COLUMNS))))
        for row, told in enumerate(table.words("images")):
            names = str(told).split()
            if any(name != Path(name).name for name in names):
                where = f"column images, row {row}"
                raise InputError(path / SAMPLES_FILE, where, f"is {told!r}", _MEND)
            files.append({_camera(name): path / name for name in names})
    if not ahead:
        place = folders[0] if folders else "read_samples"
        raise InputError(place, "samples", "there are none", "collect some, and look at failures")
    joined = {name: np.concatenate(values) for name, values in rows.items()}
    return DrivingSamples(
        joined["status"].astype(np.float32),
        joined["planner"].reshape(-1, WAYPOINTS, 3),
        joined["expert"].reshape(-1, WAYPOINTS, 3),
        np.array(ahead, np.object_),
        tuple(boxes),
        tuple(files),
    )


def _camera(name: str) -> str:
    return name.partition("-")[2].removesuffix(".png")


def train_in_the_loop(
    planner: Learner,
    episodes: Callable[[int], Sequence[Episode]],
    out: str | Path,
    *,
    rounds: int = 3,
    expert: str | Planner = "expert",
    progress: Progress | None = None,
) -> list[list[CollectedRollout]]:
    """Rounds of driving and learning; the samples of all rounds so far are learnt from.

    The expert drives the first round, the planner all others. Samples of a round that was killed
    stay; what was learnt is the planner's to keep.

    Args:
        episodes: rollouts of a round, by its number.
        out: folder; `round-0`, `round-1`, ... in it are those of `collect_samples`.

    Returns:
        What became of the episodes of each round.

    Raises:
        InputError: fewer than one round; see also `collect_samples`.
        Exception: whatever `learn` raises.
    """
    require_range(1, rounds=rounds)
    folders: list[Path] = []
    found = []
    for number in range(rounds):
        folders.append(Path(out) / f"round-{number}")
        found.append(
            collect_samples(
                planner,
                episodes(number),
                folders[-1],
                expert=expert,
                expert_drives=float(number == 0),
                seed=number,
            )
        )
        planner.learn(tuple(folders))
        if progress is not None:
            progress(number + 1, rounds)
    return found
