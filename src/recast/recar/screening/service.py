"""What the page of the screening shows, asks for and decides, without HTTP."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any, Literal

from recast.core.errors import InputError
from recast.recar.targets import TargetCache
from recast.recar.targets.decisions import DECISIONS, Conflict, Decision, Screening
from recast.recar.targets.views import nearest_views
from recast.recar.views import VehicleSource

Order = Literal["id", "lowest", "highest"]
ORDERS: tuple[Order, ...] = ("lowest", "highest", "id")
Show = Literal["undecided", "decided", "accept", "reject", "all"]
SHOWS: tuple[Show, ...] = ("undecided", "decided", "accept", "reject", "all")
MOST_ITEMS = 200
"""Of an answer."""

SIDES = ("front", "rear", "left", "right")
"""Views that a target was made from, in the order of the cache."""


@dataclass(frozen=True)
class Entry:
    """The target of identity `id`; `score` sorts and filters it, None if it was not scored."""

    id: str
    score: float | None


@dataclass(frozen=True)
class Filter:
    """What is shown.

    Attributes:
        show: targets to show, by their decision.
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
        entries: entries in any order; their ids are unique.
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


class RefusedDecisionError(ValueError):
    """A request that cannot be answered.

    Attributes:
        status: HTTP status.
        answer: what the page needs to go on.
    """

    def __init__(self, status: int, message: str, answer: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.status = status
        self.answer = {**(answer or {}), "error": message}


class ScreeningService:
    """One cache on the page.

    Args:
        cache: cache to screen; it may still be in the making: what it holds now is screened.
        pictures: set that the cache was made from, for the input views; None shows none.

    Raises:
        InputError: the cache has no target, or is of another set than `pictures`.
    """

    def __init__(self, cache: TargetCache, pictures: VehicleSource | None = None) -> None:
        self.cache = cache
        self.screening = Screening(cache.folder)
        self.catalogue = Catalogue(
            Entry(name, cache.records[name].score) for name in cache.ids(accepted_only=False)
        )
        if not self.catalogue:
            raise InputError(
                cache.folder,
                "targets",
                "none can be screened",
                "make targets first: recast recar targets",
            )
        if pictures is not None and pictures.record.name != cache.record.vehicle_set:
            raise InputError(
                pictures.folder,
                "set",
                f"is {pictures.record.name!r}, but the targets are of {cache.record.vehicle_set!r}",
                "give the set that the targets were made from",
            )
        self._pictures = pictures
        self._views = () if pictures is None else nearest_views(pictures.record)

    def state(self) -> dict[str, Any]:
        """What does not change while a page is open."""
        quality = self.cache.record.filter
        return {
            "cache": self.cache.folder.resolve().name,
            "model": self.cache.record.model.name,
            "total": len(self.catalogue),
            "failures": sum(one.failure is not None for one in self.cache.records.values()),
            "score": quality.score,
            "threshold": quality.threshold,
            "sides": SIDES if self._pictures is not None else (),
            "revision": self.screening.revision,
        }

    def summary(self) -> str:
        """How far the screening is, in words."""
        self.screening.refresh()
        found = self.catalogue.counts(Filter(), self.screening.decisions)
        return (
            f"{found['all'] - found['undecided']} of {found['all']} decided, {found['accept']} "
            f"accepted, {found['reject']} rejected"
        )

    def items(self, query: Mapping[str, str]) -> dict[str, Any]:
        """Targets in an order: those after one, those before one, or the one at an id.

        Args:
            query: query with one of `after`, `before` and `at`, or none for the first; with
                `order`, `limit` and the members of a filter.
        """
        order, wanted = _order(query), _filter(query)
        limit = min(max(int(_number(query, "limit") or 40), 1), MOST_ITEMS)
        self.screening.refresh()
        decisions = self.screening.decisions
        if "at" in query:
            found = [self.catalogue[self._known(query["at"])]]
        elif "before" in query:
            name = self._known(query["before"])
            found = self.catalogue.before(name, order, wanted, decisions, limit)
        else:
            start = self._known(query["after"]) if "after" in query else None
            found = self.catalogue.after(start, order, wanted, decisions, limit)
        return {"items": [self._item(entry) for entry in found], **self.news(query)}

    def search(self, query: Mapping[str, str]) -> dict[str, Any]:
        """Ids that hold `text`."""
        text = query.get("text", "")
        return {"ids": [entry.id for entry in self.catalogue.search(text, 12)] if text else []}

    def news(self, query: Mapping[str, Any]) -> dict[str, Any]:
        """What was decided after revision `since`, here and on other pages, and the counts."""
        self.screening.refresh()
        revision = self.screening.revision
        since = _number(query, "since")
        changes = self.screening.changes(revision if since is None else int(since))
        return {
            "revision": revision,
            "changes": {change.id: change.after for change in changes},
            "counts": self.catalogue.counts(_filter(query), self.screening.decisions),
        }

    def decide(self, body: Mapping[str, Any]) -> dict[str, Any]:
        """Decide about target `id`; `since` is the revision that the page saw."""
        name, decision, since = body.get("id"), body.get("decision"), _number(body, "since")
        if decision not in DECISIONS:
            raise RefusedDecisionError(400, f"decision: use one of {', '.join(DECISIONS)}")
        name = self._known(name)
        try:
            self.screening.decide(name, decision, revision=None if since is None else int(since))
        except Conflict as conflict:
            raise RefusedDecisionError(409, str(conflict), self.news(body)) from None
        return self.news(body)

    def undo(self, body: Mapping[str, Any]) -> dict[str, Any]:
        """Take back the last change; `undone` is its target, None where there is none left."""
        since = _number(body, "since")
        try:
            undone = self.screening.undo(revision=None if since is None else int(since))
        except Conflict as conflict:
            raise RefusedDecisionError(409, str(conflict), self.news(body)) from None
        return {"undone": None if undone is None else undone.id, **self.news(body)}

    def preview(self, name: str) -> bytes:
        """The contact sheet of a target, PNG."""
        try:
            return self.cache.preview_path(self._known(name)).read_bytes()
        except OSError:
            raise RefusedDecisionError(404, f"no contact sheet of {name}") from None

    def input_view(self, name: str, side: str) -> bytes:
        """The picture that the model saw from a side, PNG."""
        name = self._known(name)
        if self._pictures is None or side not in SIDES or name not in self._pictures.identities:
            raise RefusedDecisionError(404, f"no {side[:10]} view of {name}")
        return self._pictures.identities[name].encoded(self._views[SIDES.index(side)])

    def _known(self, name: Any) -> str:
        # Paths are only made of ids that the catalogue holds.
        if not isinstance(name, str) or name not in self.catalogue:
            raise RefusedDecisionError(404, f"no target {str(name)[:100]!r}")
        return name

    def _item(self, entry: Entry) -> dict[str, Any]:
        record = self.cache.records[entry.id]
        return {
            "id": entry.id,
            "decision": self.screening.decision(entry.id),
            "score": record.score,
            "turned": record.score_flipped,
            "kind": record.kind,
            "colour": record.colour,
            "voxels": record.voxels,
            "split": record.split,
        }


def _order(query: Mapping[str, Any]) -> Order:
    for order in ORDERS:
        if query.get("order", "id") == order:
            return order
    raise RefusedDecisionError(400, f"order: use one of {', '.join(ORDERS)}")


def _filter(query: Mapping[str, Any]) -> Filter:
    for show in SHOWS:
        if query.get("show", "all") == show:
            return Filter(show, _number(query, "lowest"), _number(query, "highest"))
    raise RefusedDecisionError(400, f"show: use one of {', '.join(SHOWS)}")


def _number(query: Mapping[str, Any], name: str) -> float | None:
    value = query.get(name)
    if value is None or value == "":
        return None
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise RefusedDecisionError(400, f"{name}: is not a number")
    return number
