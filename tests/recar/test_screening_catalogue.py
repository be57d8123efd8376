from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from recast.recar.screening import DECISIONS, Catalogue, Decision, Entry, Filter
from recast.recar.screening.service import ORDERS, SHOWS, Order, Show

ENTRIES = (Entry("b", 5.0), Entry("a", 4.0), Entry("c", None), Entry("car-2", 4.0))
CATALOGUE = Catalogue(ENTRIES)
EVERYTHING = Filter()


def ids(entries: list[Entry]) -> list[str]:
    return [entry.id for entry in entries]


def test_orders() -> None:
    assert ids(CATALOGUE.after(None, "id", EVERYTHING, {}, 9)) == ["a", "b", "c", "car-2"]
    assert ids(CATALOGUE.after(None, "lowest", EVERYTHING, {}, 9)) == ["a", "car-2", "b", "c"]
    assert ids(CATALOGUE.after(None, "highest", EVERYTHING, {}, 9)) == ["b", "a", "car-2", "c"]


def test_a_stretch_after_and_before_one() -> None:
    assert ids(CATALOGUE.after("a", "lowest", EVERYTHING, {}, 2)) == ["car-2", "b"]
    assert ids(CATALOGUE.before("c", "lowest", EVERYTHING, {}, 2)) == ["car-2", "b"]
    assert CATALOGUE.before("a", "lowest", EVERYTHING, {}, 2) == []
    assert CATALOGUE.after("c", "lowest", EVERYTHING, {}, 2) == []


def test_filters() -> None:
    decisions: dict[str, Decision] = {"a": "reject", "b": "accept"}
    found = {show: ids(CATALOGUE.after(None, "id", Filter(show), decisions, 9)) for show in SHOWS}
    assert found == {
        "undecided": ["c", "car-2"],
        "decided": ["a", "b"],
        "accept": ["b"],
        "reject": ["a"],
        "all": ["a", "b", "c", "car-2"],
    }
    low = Filter("all", 4.0, 4.5)
    assert ids(CATALOGUE.after(None, "id", low, {}, 9)) == ["a", "car-2"]
    assert CATALOGUE.counts(low, decisions) == {
        "accept": 0,
        "reject": 1,
        "undecided": 1,
        "all": 2,
    }


def test_search_puts_beginnings_first() -> None:
    catalogue = Catalogue(Entry(name, None) for name in ("old-car", "Car-1", "car-1", "van"))
    assert ids(catalogue.search("car", 9)) == ["car-1", "Car-1", "old-car"]
    assert ids(catalogue.search("car", 1)) == ["car-1"]
    assert ids(catalogue.search("bus", 9)) == []


@settings(max_examples=60, deadline=None)
@given(
    st.dictionaries(
        st.text("abc", min_size=1, max_size=3),
        st.tuples(st.none() | st.sampled_from([1.0, 2.0, 3.0]), st.sampled_from(DECISIONS)),
        min_size=1,
    ),
    st.sampled_from(ORDERS),
    st.integers(1, 3),
)
def test_walking_while_deciding_meets_each_once(
    made: dict[str, tuple[float | None, Decision]], order: Order, limit: int
) -> None:
    catalogue = Catalogue(Entry(name, score) for name, (score, _) in made.items())
    show: Show = "undecided"
    decisions: dict[str, Decision] = {}
    met: list[str] = []
    last: str | None = None
    while found := catalogue.after(last, order, Filter(show), decisions, limit):
        for entry in found:
            decisions[entry.id] = made[entry.id][1]
        met += ids(found)
        last = met[-1]
    assert met == ids(catalogue.after(None, order, Filter(), {}, len(made)))
    assert met == [*ids(catalogue.before(last or "", order, Filter(), {}, len(made))), last]
