from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from recast.cli.rows.logs import list_scenarios, place_scenarios, show_scenarios
from recast.core.errors import InputError
from recast.logs import write_log
from recast.logs.hdmap import HdMap
from recast.reporting.drawing import Canvas, CanvasView
from recast.reporting.previews import draw_scenarios, facts_table, notes, scenario_facts
from recast.simulation import MOTIONS, RolloutSetup, prepare
from support.synthetic_drives import drive


def setup_of(name: str, seconds: float = 20.0, hdmap: HdMap | None = None) -> RolloutSetup:
    return RolloutSetup(drive(seconds=seconds), "7", MOTIONS[name], map=hdmap)


def facts_of(setup: RolloutSetup):
    return scenario_facts(setup, prepare(setup))


def test_facts_of_a_cut_in() -> None:
    facts = facts_of(setup_of("cut-in-a", seconds=8))
    assert facts.name == "cut-in-a"
    assert facts.start == 0.0
    assert facts.ego_speed == pytest.approx(10.0)
    assert facts.gap == pytest.approx(6.0)
    assert facts.actor_speeds[0] == pytest.approx(8.0)
    assert facts.laterals == pytest.approx((3.5, 0.0), abs=1e-6)
    assert 1.0 < facts.meets_log < 3.0
    assert (facts.seconds, facts.asked) == (8.0, 16.0)
    assert notes([facts]) == ["cut-in-a: the log ends 8.0 s after the start"]
    assert facts_table([facts]).row_count == 1


def test_an_actor_that_leaves_the_road_is_noted() -> None:
    area = np.array([[-5.0, -6.0], [40.0, -6.0], [40.0, 6.0], [-5.0, 6.0]])
    wide = np.array([[39.0, -6.0], [250.0, -6.0], [250.0, 1.7], [39.0, 1.7]])
    facts = facts_of(setup_of("advancing-a", hdmap=HdMap({}, (area, wide))))
    assert 3.0 < facts.off_road < 8.0
    assert "the actor leaves the drivable area" in notes([facts])[0]


def test_the_picture_shows_every_scenario() -> None:
    parts = []
    for name in ("cut-in-a", "stationary-b"):
        setup = setup_of(name, seconds=8)
        prepared = prepare(setup)
        parts.append((setup, prepared, scenario_facts(setup, prepared)))
    one, both = draw_scenarios(parts[:1]), draw_scenarios(parts)
    assert one.dtype == np.uint8
    assert both.shape[0] > one.shape[0]
    np.testing.assert_array_equal(both[: len(one)], one)
    for colour in ((86, 164, 255), (255, 159, 67), (255, 82, 82)):  # ego, actor, end of the road
        assert np.all(one == colour, axis=-1).sum() > 50


def test_show_writes_what_can_run_and_names_what_cannot(tmp_path: Path) -> None:
    write_log(drive(seconds=6), tmp_path / "log")
    out, console = tmp_path / "s.png", Console(record=True, width=200)
    show_scenarios(place_scenarios(tmp_path / "log", ["oncoming"], "7", 50), out, console)
    assert out.stat().st_size > 5000
    text = console.export_text()
    assert "oncoming-a" in text
    assert "oncoming-b: refused: synthetic: rollout oncoming-b-scene: the actor would leave" in text
    with pytest.raises(InputError, match="the actor would leave"):
        show_scenarios(place_scenarios(tmp_path / "log", ["oncoming-b"], "7", 50), out, console)
    with pytest.raises(InputError, match=r"is not a PNG"):
        show_scenarios([], tmp_path / "s.jpg", console)


def test_list_names_all_with_their_numbers() -> None:
    console = Console(record=True, width=120)
    list_scenarios([], console)
    text = console.export_text()
    assert all(name in text for name in MOTIONS)
    assert "stop_distance 15 m" in text
    assert "stop_after 0.5 s" in text


def test_a_hostile_description_is_text(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(
        "version: 1\nname: x\nmotion: advancing\nsettings: {a: {gap: 5, speed: 0.5}}\n"
        'description: "[/bold] [red] \\x1b[2J <script>"\n'
    )
    console = Console(record=True, width=120)
    list_scenarios([str(path)], console)
    text = console.export_text()
    assert "[/bold] [red] \\x1b[2J <script>" in text


def test_any_name_can_be_drawn() -> None:
    for name in ("../x", "a\0b", "\u202egnp", "\ud800", "x" * 5000, "\x1b[2J", ""):
        canvas = Canvas(CanvasView(np.zeros(2), 0.0, 1.0, 200, 40), (0, 0, 0))
        canvas.text((5, 5), name)
        assert canvas.image.shape == (40, 200, 3)
