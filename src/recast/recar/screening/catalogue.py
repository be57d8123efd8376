"""Which targets there are to screen, in which order, and which of them a filter lets through."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Literal

from recast.recar.targets.decisions import DECISIONS, Decision

Order = Literal["id", "lowest", "highest"]
ORDERS: tuple[Order, ...] = ("lowest", "highest", "id")
Show = Literal["undecided", "decided", "accept", "reject", "all"]
SHOWS: tuple[Show, ...] = ("undecided", "decided", "accept", "reject", "all")


@dataclass(frozen=True)
class Entry:
    """One target.

    Attributes:
        id: of its identity.
        score: by which it is sorted and filtered; None where it was not scored.
    """

    id: str
    score: float | None


@dataclass(frozen=True)
class Filter:
    """What is shown.

    Attributes:
        show: by decision.
        lowest, highest: bounds of the score, both included; targets without a score pass where
            neither is given.
    """

    show: Show = "all"
    lowest: float | None = None
    highest: float | None = None

    def in_range(self, score: float | None) -> bool:
        """Whether a score lies within the bounds."""
        if score is None:
            return self.lowest is None and self.highest is None
        return (self.lowest is None or score >= self.lowest) and (
            self.highest is None or score <= self.highest
        )

    def shows(self, decision: Decision | None) -> bool:
        """Whether a target with this decision is shown."""
        if self.show == "all":
            return True
        if self.show in ("undecided", "decided"):
            return (decision is None) == (self.show == "undecided")
        return decision == self.show


class Catalogue:
    """The targets of a cache in every order.

    A place in an order is told by the id of the target there and not by a number, so that
    decisions made on the way, which change what a filter shows, neither skip nor repeat any.

    Args:
        entries: in any order; ids are unique.
    """

    def __init__(self, entries: Iterable[Entry]) -> None:
        self._entries = {entry.id: entry for entry in entries}
        self._sorted: dict[Order, list[Entry]] = {}
        self._place: dict[Order, dict[str, int]] = {}
        for order in ORDERS:
            found = sorted(self._entries.values(), key=lambda entry: _key(entry, order))
            self._sorted[order] = found
            self._place[order] = {entry.id: place for place, entry in enumerate(found)}
        # Of the last bounds: counted at every key press, changed seldom.
        self._within: tuple[tuple[float | None, float | None], list[str]] | None = None
        self._names = [entry.id for entry in self._sorted["id"]]

    def __len__(self) -> int:
        return len(self._entries)

    def __contains__(self, name: object) -> bool:
        return name in self._entries

    def __getitem__(self, name: str) -> Entry:
        return self._entries[name]

    def after(
        self,
        name: str | None,
        order: Order,
        wanted: Filter,
        decisions: Mapping[str, Decision],
        limit: int,
    ) -> list[Entry]:
        """Up to `limit` targets that a filter shows, those that follow `name`, or the first."""
        start = 0 if name is None else self._place[order][name] + 1
        following = islice(self._sorted[order], start, None)
        return list(islice(_shown(following, wanted, decisions), limit))

    def before(
        self,
        name: str,
        order: Order,
        wanted: Filter,
        decisions: Mapping[str, Decision],
        limit: int,
    ) -> list[Entry]:
        """Up to `limit` targets that a filter shows, those that lead up to `name`."""
        leading = self._sorted[order][: self._place[order][name]]
        return list(islice(_shown(reversed(leading), wanted, decisions), limit))[::-1]

    def counts(self, wanted: Filter, decisions: Mapping[str, Decision]) -> dict[str, int]:
        """Targets within the bounds of the score, by decision, and their number as "all"."""
        bounds, last = (wanted.lowest, wanted.highest), self._within
        if last is None or last[0] != bounds:
            names = [one.id for one in self._sorted["id"] if wanted.in_range(one.score)]
            last = self._within = (bounds, names)
        found = Counter(map(decisions.get, last[1]))
        counts: dict[str, int] = {decision: found[decision] for decision in DECISIONS}
        return counts | {"undecided": found[None], "all": len(last[1])}

    def search(self, text: str, limit: int) -> list[Entry]:
        """Ids that begin with `text`, then those that hold it, whatever the case of letters."""
        low = bisect_left(self._names, text)
        high = bisect_right(self._names, text + "\U0010ffff")
        begin = self._names[low:high]
        inside = (n for n in self._names if text.lower() in n.lower() and not n.startswith(text))
        return [self._entries[name] for name in islice((*begin, *inside), limit)]


def _shown(
    entries: Iterable[Entry], wanted: Filter, decisions: Mapping[str, Decision]
) -> Iterator[Entry]:
    for entry in entries:
        if wanted.in_range(entry.score) and wanted.shows(decisions.get(entry.id)):
            yield entry


def _key(entry: Entry, order: Order) -> tuple[float, str]:
    if order == "id":
        return 0.0, entry.id
    if entry.score is None:
        return math.inf, entry.id
    return (entry.score if order == "lowest" else -entry.score), entry.id
