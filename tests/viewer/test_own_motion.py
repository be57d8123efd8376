"""Motions from the page: numbers, a dragged start, and scenario files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.logs import DrivingLog, HdMap
from recast.simulation import (
    MOTIONS,
    PreparedRollout,
    RolloutSetup,
    ScriptedMotion,
    TimedPath,
    prepare,
    read_scenario,
)
from recast.simulation.scenario import motion_numbers
from recast.viewer.panel_run import changed, dragged, quantities, save_scenario


def own(motion: str = "oncoming-a", name: str = "mine", **numbers: float) -> ScriptedMotion:
    base = MOTIONS[motion]
    return changed(base, name, {**motion_numbers(base), **numbers})


def test_numbers_are_those_that_were_given() -> None:
    found = own("cut-in-a", gap=11.0)
    assert motion_numbers(found) == {**motion_numbers(MOTIONS["cut-in-a"]), "gap": 11.0}
    assert (found.name, found.setting) == ("mine", "page")


def test_optional_numbers_may_be_left_out() -> None:
    base = MOTIONS["oncoming-a"]
    found = changed(base, "mine", {**motion_numbers(base), "stop_distance": None})
    assert "stop_distance" not in motion_numbers(found) and "stop_distance" in quantities(base)


@pytest.mark.parametrize("name", ["../up", "a/b", "", "..", "/etc/x"])
def test_names_that_are_no_words_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="name"):
        own(name=name)


def test_numbers_out_of_range_are_refused() -> None:
    with pytest.raises(InputError, match="gap"):
        own(gap=1e6)


@pytest.mark.parametrize(
    ("motion", "numbers"),
    [
        ("oncoming-a", {"gap": 6.0}),
        ("stationary-a", {"min_gap": 2.0, "braking": 20.0, "reserve": 3.0}),  # 6.2 m at 8 m/s
        ("cut-in-a", {"gap": 2.0}),
    ],
)
def test_the_actor_starts_where_it_was_dragged(
    motion: str, numbers: dict[str, float], tiny_log: DrivingLog, tiny_map: HdMap
) -> None:
    def start(motion: ScriptedMotion) -> tuple[PreparedRollout, np.ndarray]:
        setup = RolloutSetup(tiny_log, "0", motion, map=tiny_map, steps=4)
        prepared = prepare(setup)
        s, lateral = prepared.route.project(prepared.actor[0])
        return prepared, np.array([s, lateral])

    before = own(motion, **numbers)
    prepared, there = start(before)
    place = prepared.route.pose(there[0] + 1.5, there[1] + 0.4)
    after = own(motion, **{**numbers, **dragged(before, prepared, place)})
    moved = start(after)[1] - there
    sideways = 0.4 if "lateral" in quantities(before) else 0.0
    assert moved == pytest.approx([1.5, sideways], abs=0.02)


def test_a_saved_file_is_read_back_as_it_was(tmp_path: Path) -> None:
    motion = own(gap=25.0, lateral=1.0)
    path = save_scenario(motion, tmp_path / "new" / "folder")
    assert path == tmp_path / "new" / "folder" / "mine.yaml"
    assert read_scenario(path) == (motion,)
    with pytest.raises(InputError, match="exists already"):
        save_scenario(motion, path.parent)


def test_the_rows_of_a_path_stay() -> None:
    path = TimedPath("a", ((0.0, 5.0, 1.0, 0.1), (2.0, 9.0, 1.0, 0.1)), name="there")
    found = changed(path, "mine", {"start_after": 2.0})
    assert isinstance(found, TimedPath)
    assert (found.path, found.start_after, found.name) == (path.path, 2.0, "mine")
