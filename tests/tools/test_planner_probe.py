"""A probe's rollouts are used again by the same code and settings alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from recast.runs import sources
from recast.simulation import MOTIONS
from recast_tools.planner_probe import ProbeRequest, rollout_folder

REQUEST = ProbeRequest("gtrs-mini", Path("out"), (), (), 1, 4.0, False, 1)


def test_what_a_rollout_depends_on_is_in_its_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    world, motion = SimpleNamespace(name="underpass", seed=1), MOTIONS["cut-in-a"]

    def place(request: ProbeRequest = REQUEST, source: str = "a", how: str = "visible") -> Path:
        return rollout_folder(request, source, world, motion, how)

    same = place()
    assert place() == same and same.parent == Path("out")
    assert same.name.startswith("underpass-1-cut-in-a-visible-")
    others = {
        place(source="b"),  # an edited planner
        place(how="erased"),
        place(replace(REQUEST, seconds=5.0)),
        place(replace(REQUEST, full_size=True)),
    }
    monkeypatch.setitem(sources.RECIPES, "rollout", sources.RECIPES["rollout"] + 1)
    others.add(place())
    motion = replace(motion, description="another")
    others.add(place())
    assert len(others | {same}) == 7
