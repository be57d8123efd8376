"""What is in a cache of targets, in figures."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table
from rich.text import Text

from recast.errors import printable
from recast.recar.record import SPLITS
from recast.recar.targets.cache import TargetCache


@dataclass(frozen=True)
class TargetStatistics:
    """Figures of a cache.

    Attributes:
        done: vehicles with a record.
        failures: reasons with how often, the most frequent first.
        rejected: by a person.
        below: not rejected, below the threshold.
        accepted: by split.
        doubtful: targets nobody decided about that score higher with front and rear exchanged.
        voxels: least, median and most of accepted targets; zeros where there is none.
        scores: of all targets that have one, sorted.
    """

    done: int
    failures: dict[str, int]
    rejected: int
    below: int
    accepted: dict[str, int]
    doubtful: int
    voxels: tuple[int, int, int]
    scores: tuple[float, ...]


def target_statistics(cache: TargetCache) -> TargetStatistics:
    """Count targets; see `TargetCache.statistics` for the values of their latents."""
    made, accepted = cache.ids(accepted_only=False), cache.ids()
    rejected = sum(cache.decisions.get(one) == "reject" for one in made)
    splits = Counter(cache.records[one].split for one in accepted)
    voxels = [cache.records[one].voxels for one in accepted]
    failures = Counter(one.failure for one in cache.records.values() if one.failure is not None)
    return TargetStatistics(
        done=len(cache.records),
        failures=dict(sorted(failures.items(), key=lambda item: (-item[1], item[0]))),
        rejected=rejected,
        below=len(made) - rejected - len(accepted),
        accepted={split: splits[split] for split in SPLITS},
        doubtful=sum(_rear_to_front(cache, one) for one in made),
        voxels=(min(voxels), int(np.median(voxels)), max(voxels)) if voxels else (0, 0, 0),
        scores=tuple(sorted(r.score for r in cache.records.values() if r.score is not None)),
    )


def _rear_to_front(cache: TargetCache, identity: str) -> bool:
    record = cache.records[identity]
    if identity in cache.decisions or record.score is None or record.score_flipped is None:
        return False
    return record.score_flipped > record.score


def target_table(cache: TargetCache, statistics: TargetStatistics) -> Group:
    """The figures for a terminal."""
    record, score = cache.record, statistics.scores
    title = Text(printable(record.vehicle_set))
    summary = Table(title=title, title_justify="left", box=SIMPLE_HEAD, show_header=False)
    failed = sum(statistics.failures.values())
    accepted = sum(statistics.accepted.values())
    rows = [
        ("model", f"{printable(record.model.name)} ({record.model.sha256[:12]})"),
        ("vehicles", f"{statistics.done:,} done, {failed:,} without a target"),
        (
            "accepted",
            f"{accepted:,}: {statistics.accepted['train']:,} train, "
            f"{statistics.accepted['held-out']:,} held out",
        ),
        ("left out", f"{statistics.below:,} below the threshold, {statistics.rejected:,} rejected"),
        ("rear to front", f"{statistics.doubtful:,} agree better so: look at them"),
        ("voxels", "{:,} to {:,}, median {:,}".format(*(statistics.voxels[i] for i in (0, 2, 1)))),
    ]
    if score:
        tenth, median, most = (score[int(q * (len(score) - 1))] for q in (0.1, 0.5, 0.9))
        rows.append(
            (
                record.filter.score or "score",
                f"median {median:.3f}, 80 % in {tenth:.3f} to {most:.3f}, "
                f"threshold {record.filter.threshold:g}",
            )
        )
    for name, text in rows:
        summary.add_row(name, Text(text))
    parts: list[Table] = [summary]
    if statistics.failures:
        reasons = Table(box=SIMPLE_HEAD)
        reasons.add_column("why there is no target")
        reasons.add_column("vehicles", justify="right")
        for reason, count in statistics.failures.items():
            reasons.add_row(Text(printable(reason)), f"{count:,}")
        parts.append(reasons)
    return Group(*parts)
