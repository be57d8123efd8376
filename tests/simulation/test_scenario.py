from __future__ import annotations

from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast.simulation import MOTIONS, parse_motions, scenario_name


def test_every_name_reads_back() -> None:
    assert len(MOTIONS) == 20
    for name, motion in MOTIONS.items():
        assert scenario_name(motion) == name
        assert parse_motions(name) == (motion,)


def test_without_a_letter_it_is_all_settings() -> None:
    assert parse_motions("cut-in") == (MOTIONS["cut-in-a"], MOTIONS["cut-in-b"])
    stop = parse_motions("cut-in-stop")
    assert stop == (MOTIONS["cut-in-stop-a"], MOTIONS["cut-in-stop-b"])
    assert [m.name for m in parse_motions("Oncoming")] == ["oncoming", "oncoming"]
    assert parse_motions(" oncoming-Through ")[1] is MOTIONS["oncoming-through-b"]


@pytest.mark.parametrize("name", ["cutin", "cut-in-c", "", "stationary-"])
def test_unknown_names_list_the_known(name: str) -> None:
    with pytest.raises(InputError, match="stationary, advancing, crossing"):
        parse_motions(name)


OWN = """\
version: 1
name: near-stop
motion: stationary
settings:
  near: {min_gap: 12, braking: 6.0, reserve: 2.0}
"""


def test_a_file_stands_where_a_name_does(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(OWN)
    (motion,) = parse_motions(f" {path} ")
    assert scenario_name(motion) == "near-stop-near"
    assert motion.min_gap == 12.0


def test_a_file_must_not_take_the_name_of_a_built_in_scenario(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(OWN.replace("near-stop", "stationary").replace("near:", "a:"))
    with pytest.raises(InputError, match="stationary with setting a is a built-in scenario"):
        parse_motions(str(path))


def test_a_missing_file_says_so() -> None:
    with pytest.raises(InputError, match=r"mine\.yaml: file: is missing"):
        parse_motions("mine.yaml")
