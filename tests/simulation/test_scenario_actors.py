"""Scenario files with further actors."""

from __future__ import annotations

from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast.planning import ConstantVelocity
from recast.simulation import (
    MOTIONS,
    CutIn,
    Idm,
    LoggedMotion,
    RolloutSettings,
    RolloutSetup,
    Scenario,
    ScenarioActor,
    Simulator,
    further_actors,
    motion,
    motion_of_record,
    parse_motions,
    read_scenario,
    replaced_tracks,
    run_rollout,
    scenario_name,
    scenario_numbers,
    scenario_record,
    target_motion,
)
from support.controlled_tracks import line, with_track
from support.synthetic_drives import drive

GOOD = """\
version: 1
name: boxed-in
motion: cut-in
description: Several cars.
settings:
  a: {gap: 6, initial_speed: 0.8, target_speed: 0.5, delay: 0.5, duration: 2.5}
  b: {gap: 12, initial_speed: 0.7, target_speed: 0.35, delay: 1, duration: 3}
actors:
  5:
    motion: idm
    replaced: true
    settings:
      a: {speed: 0.6, gap: 40.0, lateral: 0.2}
      b: {}
  "un/usual id":
    motion: log-replay
"""

NAMES = {"name": "boxed-in", "description": "Several cars."}
EXAMPLE = Path(__file__).parents[2] / "examples" / "boxed_in.yaml"


def read(tmp_path: Path, text: str) -> tuple[object, ...]:
    path = tmp_path / "my.yaml"
    path.write_text(text)
    return read_scenario(path)


def test_a_file_with_further_actors(tmp_path: Path) -> None:
    a, b = read(tmp_path, GOOD)
    assert a == Scenario(
        motion=CutIn("a", 6.0, 0.8, 0.5, 0.5, 2.5, **NAMES),
        setting="a",
        actors=(
            ScenarioActor("5", Idm("a", speed=0.6, gap=40.0, lateral=0.2), replaced=True),
            ScenarioActor("un/usual id", LoggedMotion("a")),
        ),
        **NAMES,
    )
    assert isinstance(b, Scenario)
    assert b.actors[0] == ScenarioActor("5", Idm("b"), replaced=True)
    assert hash(a) != hash(b)
    assert scenario_name(b) == "boxed-in-b"
    assert replaced_tracks(a) == ("5",)
    assert (target_motion(a), further_actors(a)) == (a.motion, a.actors)
    assert replaced_tracks(MOTIONS["cut-in-a"]) == () == further_actors(MOTIONS["cut-in-a"])
    assert scenario_numbers(a)[-2:] == [
        "track 5: idm, speed 0.6 of v_r, headway 1.5 s, min_gap 2 m, gap 40 m, lateral 0.2 m",
        "track un/usual id: log-replay",
    ]


def test_it_survives_its_record(tmp_path: Path) -> None:
    for scenario in read(tmp_path, GOOD):
        assert motion_of_record(scenario_record(scenario)) == scenario  # type: ignore[arg-type]


def test_an_own_motion_has_no_record() -> None:
    class Own:
        name, setting = "own", "a"

        def script(self, start: object, steps: int, dt: float) -> object:
            return None

    scenario = Scenario("x", "a", MOTIONS["cut-in-a"], (ScenarioActor("5", Own()),))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="motion own: is a Own, which a scenario file"):
        scenario_record(scenario)


def test_it_stands_wherever_a_motion_does(tmp_path: Path) -> None:
    log = with_track(drive(), "5", line((20.0, -12.0, 0.0), 2.0))
    log = with_track(log, "un/usual id", line((0.0, 7.0, 0.0), 12.0))
    path = tmp_path / "my.yaml"
    path.write_text(GOOD)
    first, _ = parse_motions(str(path))
    assert motion(path) == motion(str(path)) == first == motion(first)
    setup = RolloutSetup(log, "7", first, steps=10)
    assert setup.name == "boxed-in-a-scene" and setup.replaced == ("5",)
    assert list(setup.controlled) == ["7", "5", "un/usual id"]
    rollout = run_rollout(setup, ConstantVelocity())
    assert (rollout.motion, rollout.setting) == ("boxed-in", "a")
    assert [actor.track_id for actor in rollout.controlled] == ["5", "un/usual id"]
    assert rollout.reactive == ("5",)
    sim = Simulator(log, actors={"7": path}, settings=RolloutSettings(steps=10))
    assert len(sim.reset().actors) == 3
    with pytest.raises(InputError, match="track 9 is given the scenario boxed-in, which has sev"):
        Simulator(log, actors={"7": "cut-in", "9": first})
    with pytest.raises(InputError, match="track 5 is given twice"):
        RolloutSetup(log, "5", first)
    with pytest.raises(InputError, match="track 5 is given twice"):
        Simulator(log, actors={"7": first, "5": "idm"})


def test_a_name_gives_its_first_setting() -> None:
    assert motion("cut-in") is MOTIONS["cut-in-a"] is motion("cut-in-a")
    assert motion("idm-b") is MOTIONS["idm-b"]
    with pytest.raises(InputError, match=r"choose one of .*log-replay, idm, with a setting"):
        motion("nothing")


def test_the_example_file() -> None:
    for scenario in read_scenario(EXAMPLE):
        assert isinstance(scenario, Scenario)
        assert [a.track_id for a in scenario.actors] == ["moving-1", "moving-2"]
        assert motion_of_record(scenario_record(scenario)) == scenario


def test_the_example_of_the_documentation(tmp_path: Path) -> None:
    page = EXAMPLE.parents[1] / "docs" / "scenarios.md"
    text = page.read_text().split("```yaml\n")[2].split("```")[0]
    (scenario,) = read(tmp_path, text)
    assert isinstance(scenario, Scenario)
    assert [a.track_id for a in scenario.actors] == ["5", "7"]
    assert replaced_tracks(scenario) == ("5",)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("motion: idm", "motion: idmm", "my.yaml:10: motion: is 'idmm'; choose one of cut-in,"),
        ("    motion: idm\n", "", "my.yaml:9: motion: is missing"),
        ("replaced: true", "replaced: yes", "my.yaml:11: replaced: is 'yes'; write true or false"),
        ("replaced: true", "replace: true", "my.yaml:11: replace: is not known; did you mean rep"),
        (
            "      b: {}\n",
            "",
            "my.yaml:12: b: is missing; give the settings a, b, as for the target",
        ),
        ("      b: {}", "      c: {}", "my.yaml:14: c: is not known"),
        ("b: {}", "b: 3", "my.yaml:14: setting b: is the number 3; give speed, headway"),
        ("speed: 0.6", "speed: 0", "my.yaml:13: speed: is 0; give more than 0, at most 5 of v_r"),
        ("gap: 40.0, ", "", "my.yaml:13: lateral: is an offset from the ego's route; give gap"),
        ("lateral: 0.2", "side: 2", "my.yaml:13: side: is not known"),
        (
            "motion: log-replay",
            "motion: cut-in",
            "my.yaml:15: settings: is missing; give the settings a",
        ),
        ("    motion: log-replay", "    3", "my.yaml:15: actor un/usual id: is the number 3"),
        ('  "un/usual id"', "  5", "my.yaml:15: 5: is given twice, first in line 9"),
        ('  "un/usual id"', '  ""', "my.yaml:15: actor : track id: a name must have 1 to 1000"),
        ("actors:", "actors: {}\nactor:", "my.yaml:9: actor: is not known; did you mean actors?"),
    ],
)
def test_errors_name_file_line_and_key(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    with pytest.raises(InputError) as error:
        read(tmp_path, GOOD.replace(old, new, 1))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("actors", ["actors: {}\n", "actors:\n", "actors: [1]\n", "actors: 5\n"])
def test_no_actors_are_refused(tmp_path: Path, actors: str) -> None:
    text = GOOD.split("actors:")[0] + actors
    with pytest.raises(InputError, match=r"my.yaml:8: actors: is .*; give track ids"):
        read(tmp_path, text)


def test_a_motion_without_numbers_needs_none(tmp_path: Path) -> None:
    text = "version: 1\nname: x\nmotion: log-replay\nsettings:\n  a:\n  b: {}\n"
    assert read(tmp_path, text) == (LoggedMotion("a", "x"), LoggedMotion("b", "x"))
    with pytest.raises(InputError, match=r"my.yaml:5: setting a: is a list; give nothing below"):
        read(tmp_path, text.replace("a:\n", "a: [1]\n"))
